// What launching needs to know of the device.

#include "launch.cuh"

#include <array>
#include <atomic>
#include <map>
#include <mutex>
#include <utility>

namespace bigtri {
namespace {

// What has been asked for already: a launch is so short that each question would show.
std::mutex mutex;
std::map<std::pair<const void*, int>, int> resident;
std::map<std::pair<const void*, int>, bool> overlapping;
std::map<std::pair<const void*, int>, int64_t> allowed;  // bytes

constexpr int64_t kAlwaysAllowed = 48 * 1024;  // bytes

constexpr int kDevices = 64;  // more of them are asked each time
using OfDevices = std::array<std::atomic<int>, kDevices>;  // 0: not known yet

cudaError_t attribute(cudaDeviceAttr which, OfDevices* known, int* value) {
  int device;
  BIGTRI_CUDA(current_device(&device));
  std::atomic<int>* const place = device < kDevices ? &(*known)[device] : nullptr;
  *value = place ? place->load(std::memory_order_relaxed) : 0;
  if (*value != 0) return cudaSuccess;
  BIGTRI_CUDA(cudaDeviceGetAttribute(value, which, device));
  if (place) place->store(*value, std::memory_order_relaxed);
  return cudaSuccess;
}

// By the thread that has the mutex, on its current device.
cudaError_t allow(const void* kernel, int device, int64_t shared_bytes) {
  if (shared_bytes <= kAlwaysAllowed) return cudaSuccess;
  int64_t& bytes = allowed[std::make_pair(kernel, device)];
  if (bytes >= shared_bytes) return cudaSuccess;
  BIGTRI_CUDA(cudaFuncSetAttribute(kernel, cudaFuncAttributeMaxDynamicSharedMemorySize, (int)shared_bytes));
  bytes = shared_bytes;
  return cudaSuccess;
}

}  // namespace

cudaError_t current_device(int* device) {
  const Launches* const noting = Launches::of_thread();
  if (!noting) return cudaGetDevice(device);
  *device = noting->device();
  return cudaSuccess;
}

cudaError_t overlaps_launches(const void* kernel, bool* yes) {
  int device, major;
  BIGTRI_CUDA(current_device(&device));
  const std::lock_guard<std::mutex> lock(mutex);
  const auto key = std::make_pair(kernel, device);
  if (const auto found = overlapping.find(key); found != overlapping.end()) {
    *yes = found->second;
    return cudaSuccess;
  }
  cudaFuncAttributes attributes;
  BIGTRI_CUDA(cudaDeviceGetAttribute(&major, cudaDevAttrComputeCapabilityMajor, device));
  BIGTRI_CUDA(cudaFuncGetAttributes(&attributes, kernel));
  *yes = overlapping[key] = major >= 9 && attributes.ptxVersion >= 90;
  return cudaSuccess;
}

cudaError_t multiprocessors(int* count) {
  static OfDevices known;
  return attribute(cudaDevAttrMultiProcessorCount, &known, count);
}

cudaError_t cache_bytes(int* bytes) {
  static OfDevices known;
  return attribute(cudaDevAttrL2CacheSize, &known, bytes);
}

cudaError_t allow_shared(const void* kernel, int64_t shared_bytes) {
  int device;
  BIGTRI_CUDA(current_device(&device));
  const std::lock_guard<std::mutex> lock(mutex);
  return allow(kernel, device, shared_bytes);
}

cudaError_t resident_blocks(const void* kernel, int threads, int64_t shared_bytes, int* blocks) {
  int device;
  BIGTRI_CUDA(current_device(&device));
  const std::lock_guard<std::mutex> lock(mutex);
  const auto key = std::make_pair(kernel, device);
  if (const auto found = resident.find(key); found != resident.end()) {
    *blocks = found->second;
    return cudaSuccess;
  }
  BIGTRI_CUDA(allow(kernel, device, shared_bytes));
  int processors, each;
  BIGTRI_CUDA(multiprocessors(&processors));
  BIGTRI_CUDA(cudaOccupancyMaxActiveBlocksPerMultiprocessor(&each, kernel, threads, (size_t)shared_bytes));
  *blocks = resident[key] = processors * max_of(each, 1);
  return cudaSuccess;
}

}  // namespace bigtri
