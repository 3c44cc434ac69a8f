// The registry of variants, the launch settings, and what launching needs to know of the device.

#include <map>
#include <mutex>
#include <utility>

#include "launch.cuh"

namespace bigtri {

int64_t bin_owned_scratch(const Frame& f, const Tuning& t);
cudaError_t draw_bin_owned(const Frame& f, const Tuning& t, void* scratch, cudaStream_t stream);
int64_t two_stage_scratch(const Frame& f, const Tuning& t);
cudaError_t draw_two_stage(const Frame& f, const Tuning& t, void* scratch, cudaStream_t stream);
int64_t persistent_scratch(const Frame& f, const Tuning& t);
cudaError_t draw_persistent(const Frame& f, const Tuning& t, void* scratch, cudaStream_t stream);

const CudaVariant kCudaVariants[] = {
    {"bin_owned", bin_owned_scratch, draw_bin_owned},
    {"two_stage", two_stage_scratch, draw_two_stage},
    {"persistent", persistent_scratch, draw_persistent},
    {nullptr, nullptr, nullptr},
};

namespace {

std::mutex mutex;
Tuning current;
std::map<std::pair<const void*, int>, int> resident;
std::map<std::pair<const void*, int>, bool> overlapping;

}  // namespace

Tuning tuning() {
  const std::lock_guard<std::mutex> lock(mutex);
  return current;
}

bool set_tuning(const Tuning& t) {
  constexpr int64_t kMost = 1 << 16;  // triangles that records are kept for, all of them and all parts
  const auto within = [](int64_t v, int64_t low, int64_t high) { return v >= low && v <= high; };
  const bool ok = within(t.few, 0, kMost) && within(t.some, 0, kMost) && (t.warps == 0 || t.warps == 4 || t.warps == 8 || t.warps == 16) &&
                  within(t.blocks, 0, 1 << 20) && within(t.entries, 1, kMostEntries) && within(t.queue, 1, 1 << 24) && t.threshold >= 0 &&
                  within(t.cache, 0, int64_t{1} << 40);
  if (!ok) return false;
  const std::lock_guard<std::mutex> lock(mutex);
  current = t;
  return true;
}

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

cudaError_t resident_blocks(const void* kernel, int threads, int64_t shared_bytes, int* blocks) {
  int device;
  BIGTRI_CUDA(cudaGetDevice(&device));
  const std::lock_guard<std::mutex> lock(mutex);
  const auto key = std::make_pair(kernel, device);
  if (const auto found = resident.find(key); found != resident.end()) {
    *blocks = found->second;
    return cudaSuccess;
  }
  if (shared_bytes > 48 * 1024) BIGTRI_CUDA(cudaFuncSetAttribute(kernel, cudaFuncAttributeMaxDynamicSharedMemorySize, (int)shared_bytes));
  int processors, each;
  BIGTRI_CUDA(cudaDeviceGetAttribute(&processors, cudaDevAttrMultiProcessorCount, device));
  BIGTRI_CUDA(cudaOccupancyMaxActiveBlocksPerMultiprocessor(&each, kernel, threads, (size_t)shared_bytes));
  *blocks = resident[key] = processors * max_of(each, 1);
  return cudaSuccess;
}

}  // namespace bigtri
