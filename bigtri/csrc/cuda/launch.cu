// What launching needs to know of the device.

#include "launch.cuh"

#include <map>
#include <mutex>
#include <utility>

namespace bigtri {
namespace {

std::mutex mutex;
std::map<std::pair<const void*, int>, int> resident;
std::map<std::pair<const void*, int>, bool> overlapping;

}  // namespace

cudaError_t overlaps_launches(const void* kernel, bool* yes) {
  int device, major;
  BIGTRI_CUDA(cudaGetDevice(&device));
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
  int device;
  BIGTRI_CUDA(cudaGetDevice(&device));
  return cudaDeviceGetAttribute(count, cudaDevAttrMultiProcessorCount, device);
}

cudaError_t resident_blocks(const void* kernel, int threads, int64_t shared_bytes, int* blocks) {
  int device;
  BIGTRI_CUDA(cudaGetDevice(&device));
  const std::lock_guard<std::mutex> lock(mutex);
  const auto key = std::make_pair(kernel, device);
  if (const auto found = resident.find(key); found != resident.end()) {
    *blocks = found->second;
    return cudaSuccess;
  }
  if (shared_bytes > 48 * 1024)
    BIGTRI_CUDA(cudaFuncSetAttribute(kernel, cudaFuncAttributeMaxDynamicSharedMemorySize, (int)shared_bytes));
  int processors, each;
  BIGTRI_CUDA(multiprocessors(&processors));
  BIGTRI_CUDA(cudaOccupancyMaxActiveBlocksPerMultiprocessor(&each, kernel, threads, (size_t)shared_bytes));
  *blocks = resident[key] = processors * max_of(each, 1);
  return cudaSuccess;
}

}  // namespace bigtri
