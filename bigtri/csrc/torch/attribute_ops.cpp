// The operators of the attribute pass on the CPU: interpolate, barycentrics, sample_texture, lambert, encode_srgb.

#include "attribute_checks.h"
#include "registry.h"

namespace bigtri {
namespace {

void interpolate_pixels(const char* op, const std::string& precision, const Tensor& packed, const Tensor& positions,
                        const Tensor& triangles, const Tensor* attributes, const Tensor& out) {
  const CpuRung& rung = find_rung(op, kCpuRungs, precision);
  check_interpolation(op, kCpu, packed, positions, triangles, attributes, out);
  if (out.numel() == 0) return;
  const Parallel parallel = torch_threads();
  checked_indices(op, parallel, triangles, positions.size(-2));
  AttributeJob job = {};
  job.packed = const_data<int64_t>(packed);
  job.positions = const_data<float>(positions);
  job.vertices = positions.size(-2);
  job.position_view = positions.dim() == 2 ? 0 : job.vertices * 4;
  job.triangles = const_data<int32_t>(triangles);
  job.triangle_count = triangles.size(0);
  job.views = packed.dim() == 2 ? 1 : packed.size(0);
  job.height = (int)packed.size(-2);
  job.width = (int)packed.size(-1);
  job.channels = out.size(-1);
  if (attributes) {
    job.attributes = const_data<float>(*attributes);
    job.attribute_view = attributes_shared(*attributes) ? 0 : job.vertices * job.channels;
  }
  job.out = data<float>(out);
  rung.interpolate(job, parallel);
}

void interpolate_op(const Tensor& packed, const Tensor& positions, const Tensor& triangles, const Tensor& attributes,
                    const std::string& precision, const Tensor& out) {
  interpolate_pixels("interpolate", precision, packed, positions, triangles, &attributes, out);
}

void barycentrics_op(const Tensor& packed, const Tensor& positions, const Tensor& triangles,
                     const std::string& precision, const Tensor& out) {
  interpolate_pixels("barycentrics", precision, packed, positions, triangles, nullptr, out);
}

void sample_texture_op(const Tensor& texture, const Tensor& uv, const std::string& filter, const std::string& wrap,
                       const Tensor& out) {
  check_sample(kCpu, texture, uv, filter, wrap, out);
  with_texels(texture, [&](const auto* texels) {
    sample(texels, (int)texture.size(0), (int)texture.size(1), texture.size(2), const_data<float>(uv), uv.numel() / 2,
           filter_of(filter), wrap_of(wrap), data<float>(out), torch_threads());
  });
}

void lambert_op(const Tensor& normals, const Tensor& albedo, const Tensor& ambient, const Tensor& directions,
                const Tensor& colors, const Tensor& out) {
  check_lambert(kCpu, normals, albedo, ambient, directions, colors, out);
  lambert(const_data<float>(normals), const_data<float>(albedo), const_data<float>(ambient),
          const_data<float>(directions), const_data<float>(colors), directions.size(0), normals.numel() / 3,
          data<float>(out), torch_threads());
}

void encode_srgb_op(const Tensor& linear, const Tensor& thresholds, const Tensor& out) {
  check_encode(kCpu, linear, thresholds, out);
  encode_srgb(const_data<float>(linear), const_data<float>(thresholds), linear.numel(), data<uint8_t>(out),
              torch_threads());
}

}  // namespace
}  // namespace bigtri

STABLE_TORCH_LIBRARY_IMPL(bigtri, CPU, m) {
  m.impl("interpolate", TORCH_BOX(&bigtri::interpolate_op));
  m.impl("barycentrics", TORCH_BOX(&bigtri::barycentrics_op));
  m.impl("sample_texture", TORCH_BOX(&bigtri::sample_texture_op));
  m.impl("lambert", TORCH_BOX(&bigtri::lambert_op));
  m.impl("encode_srgb", TORCH_BOX(&bigtri::encode_srgb_op));
}
