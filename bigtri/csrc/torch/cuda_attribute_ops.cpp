// The operators of the attribute pass on CUDA: interpolate, barycentrics, sample_texture, lambert, encode_srgb. None
// waits for the device.

#include "../cuda/shading.h"
#include "attribute_checks.h"
#include "cuda.h"

namespace bigtri {
namespace {

// attributes is null for the operator `barycentrics`.
void interpolate_pixels(const char* op, int device, const Tensor& packed, const Tensor& positions,
                        const Tensor& triangles, const Tensor* attributes, const std::string& precision,
                        const Tensor& out) {
  const CudaRung& rung = find_rung(op, kCudaRungs, precision);
  check_interpolation(op, device, packed, positions, triangles, attributes, out);
  if (out.numel() == 0) return;
  const torch::stable::accelerator::DeviceGuard guard(device);
  Interpolation job = {};
  job.batch = packed.dim() == 2 ? 1 : packed.size(0);
  job.height = (int)packed.size(-2);
  job.width = (int)packed.size(-1);
  job.vertices = positions.size(-2);
  job.position_view = positions.dim() == 2 ? 0 : job.vertices * 4;
  job.channels = out.size(-1);
  const Tensor scratch = empty({interpolation_scratch(job.batch, job.height, job.width)}, ScalarType::Byte, device);
  job.packed = const_data<int64_t>(packed);
  job.positions = const_data<float>(positions);
  job.triangles = const_data<int32_t>(triangles);
  job.count = (int32_t)triangles.size(0);
  job.weights = attributes == nullptr;
  if (attributes) {
    job.attributes = const_data<float>(*attributes);
    job.attribute_view = attributes_shared(*attributes) ? 0 : job.vertices * job.channels;
  }
  job.out = data<float>(out);
  job.clipped = data<uint32_t>(scratch);
  check_launch(op, rung.interpolate(job, current_stream(device)));
}

void interpolate_cuda_op(const Tensor& packed, const Tensor& positions, const Tensor& triangles,
                         const Tensor& attributes, const std::string& precision, const Tensor& out) {
  interpolate_pixels("interpolate", device_of({&packed, &positions, &triangles, &attributes, &out}), packed, positions,
                     triangles, &attributes, precision, out);
}

void barycentrics_cuda_op(const Tensor& packed, const Tensor& positions, const Tensor& triangles,
                          const std::string& precision, const Tensor& out) {
  interpolate_pixels("barycentrics", device_of({&packed, &positions, &triangles, &out}), packed, positions, triangles,
                     nullptr, precision, out);
}

void sample_texture_cuda_op(const Tensor& texture, const Tensor& uv, const std::string& filter, const std::string& wrap,
                            const Tensor& out) {
  const int device = device_of({&texture, &uv, &out});
  check_sample(device, texture, uv, filter, wrap, out);
  if (out.numel() == 0) return;
  const torch::stable::accelerator::DeviceGuard guard(device);
  with_texels(texture, [&](const auto* texels) {
    check_launch("sample_texture", sample_cuda(texels, (int)texture.size(0), (int)texture.size(1), texture.size(2),
                                               const_data<float>(uv), uv.numel() / 2, filter_of(filter), wrap_of(wrap),
                                               data<float>(out), current_stream(device)));
  });
}

void lambert_cuda_op(const Tensor& normals, const Tensor& albedo, const Tensor& ambient, const Tensor& directions,
                     const Tensor& colors, const Tensor& out) {
  const int device = device_of({&normals, &albedo, &ambient, &directions, &colors, &out});
  check_lambert(device, normals, albedo, ambient, directions, colors, out);
  if (out.numel() == 0) return;
  const torch::stable::accelerator::DeviceGuard guard(device);
  check_launch("lambert",
               lambert_cuda(const_data<float>(normals), const_data<float>(albedo), const_data<float>(ambient),
                            const_data<float>(directions), const_data<float>(colors), directions.size(0),
                            normals.numel() / 3, data<float>(out), current_stream(device)));
}

void encode_srgb_cuda_op(const Tensor& linear, const Tensor& thresholds, const Tensor& out) {
  const int device = device_of({&linear, &thresholds, &out});
  check_encode(device, linear, thresholds, out);
  if (out.numel() == 0) return;
  const torch::stable::accelerator::DeviceGuard guard(device);
  check_launch("encode_srgb", encode_srgb_cuda(const_data<float>(linear), const_data<float>(thresholds), linear.numel(),
                                               data<uint8_t>(out), current_stream(device)));
}

}  // namespace
}  // namespace bigtri

STABLE_TORCH_LIBRARY_IMPL(bigtri, CUDA, m) {
  m.impl("interpolate", TORCH_BOX(&bigtri::interpolate_cuda_op));
  m.impl("barycentrics", TORCH_BOX(&bigtri::barycentrics_cuda_op));
  m.impl("sample_texture", TORCH_BOX(&bigtri::sample_texture_cuda_op));
  m.impl("lambert", TORCH_BOX(&bigtri::lambert_cuda_op));
  m.impl("encode_srgb", TORCH_BOX(&bigtri::encode_srgb_cuda_op));
}
