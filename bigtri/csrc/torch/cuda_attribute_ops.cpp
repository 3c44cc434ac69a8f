// torch.ops.bigtri on CUDA: what reads a visibility buffer. Nothing here waits for the device.

#include "../cuda/attributes.h"
#include "attribute_checks.h"
#include "cuda.h"

namespace bigtri {
namespace {

// The device of the first tensor that is on one; the checks then find those that are elsewhere.
int device_of(std::initializer_list<const Tensor*> tensors) {
  for (const Tensor* t : tensors)
    if (t->defined() && t->is_cuda()) return t->get_device_index();
  return kCpu;
}

Tensor interpolate_pixels(const char* op, int device, const Tensor& packed, const Tensor& positions, const Tensor& triangles, const Tensor* attributes) {
  check_interpolation(op, device, packed, positions, triangles, attributes);
  const torch::stable::accelerator::DeviceGuard guard(device);
  Interpolation job = {};
  job.batch = packed.size(0);
  job.height = (int)packed.size(1);
  job.width = (int)packed.size(2);
  job.vertices = positions.size(1);
  job.channels = attributes ? attributes->size(2) : 3;
  Tensor out = empty({job.batch, packed.size(1), packed.size(2), job.channels}, ScalarType::Float, device);
  if (out.numel() == 0) return out;
  const Tensor scratch = empty({interpolation_scratch(job.batch, job.height, job.width)}, ScalarType::Byte, device);
  job.packed = const_data<int64_t>(packed);
  job.positions = const_data<float>(positions);
  job.triangles = const_data<int32_t>(triangles);
  job.count = (int32_t)triangles.size(0);
  job.weights = attributes == nullptr;
  if (attributes) {
    job.attributes = const_data<float>(*attributes);
    job.attribute_view = attributes->size(0) == 1 ? 0 : job.vertices * job.channels;
  }
  job.out = data<float>(out);
  job.clipped = data<uint32_t>(scratch);
  check_launch(op, interpolate_cuda(job, current_stream(device)));
  return out;
}

Tensor interpolate_cuda_op(const Tensor& packed, const Tensor& positions, const Tensor& triangles, const Tensor& attributes) {
  return interpolate_pixels("interpolate", device_of({&packed, &positions, &triangles, &attributes}), packed, positions, triangles, &attributes);
}

Tensor barycentrics_cuda_op(const Tensor& packed, const Tensor& positions, const Tensor& triangles) {
  return interpolate_pixels("barycentrics", device_of({&packed, &positions, &triangles}), packed, positions, triangles, nullptr);
}

Tensor sample_texture_cuda_op(const Tensor& texture, const Tensor& uv, std::string filter, std::string wrap) {
  const int device = device_of({&texture, &uv});
  check_sample(device, texture, uv, filter, wrap);
  const torch::stable::accelerator::DeviceGuard guard(device);
  const int64_t channels = texture.size(2);
  Tensor out = empty({uv.size(0), channels}, ScalarType::Float, device);
  if (out.numel() == 0) return out;
  check_launch("sample_texture", sample_cuda(const_data<float>(texture), (int)texture.size(0), (int)texture.size(1), channels, const_data<float>(uv),
                                             uv.size(0), filter_of(filter), wrap_of(wrap), data<float>(out), current_stream(device)));
  return out;
}

Tensor lambert_cuda_op(const Tensor& normals, const Tensor& albedo, const Tensor& ambient, const Tensor& directions, const Tensor& colors) {
  const int device = device_of({&normals, &albedo, &ambient, &directions, &colors});
  check_lambert(device, normals, albedo, ambient, directions, colors);
  const torch::stable::accelerator::DeviceGuard guard(device);
  Tensor out = empty({normals.size(0), 3}, ScalarType::Float, device);
  if (out.numel() == 0) return out;
  check_launch("lambert", lambert_cuda(const_data<float>(normals), const_data<float>(albedo), const_data<float>(ambient), const_data<float>(directions),
                                       const_data<float>(colors), directions.size(0), normals.size(0), data<float>(out), current_stream(device)));
  return out;
}

Tensor encode_srgb_cuda_op(const Tensor& linear, const Tensor& thresholds) {
  const int device = device_of({&linear, &thresholds});
  check_encode(device, linear, thresholds);
  const torch::stable::accelerator::DeviceGuard guard(device);
  Tensor out = empty(shape_of(linear), ScalarType::Byte, device);
  if (out.numel() == 0) return out;
  check_launch("encode_srgb",
               encode_srgb_cuda(const_data<float>(linear), const_data<float>(thresholds), linear.numel(), data<uint8_t>(out), current_stream(device)));
  return out;
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
