// The registry of variants, the launch settings, and what launching needs to know of the device.

#include <map>
#include <mutex>
#include <utility>

#include "launch.cuh"

namespace bigtri {

int64_t bin_owned_scratch(const Frame& f, const Tuning& t);
cudaError_t draw_bin_owned(const Frame& f, const Tuning& t, void* scratch, cudaStream_t stream);

const CudaVariant kCudaVariants[] = {
    {"bin_owned", bin_owned_scratch, draw_bin_owned},
    {nullptr, nullptr, nullptr},
};

namespace {

std::mutex mutex;
Tuning current;
std::map<std::pair<const void*, int>, int> resident;

}  // namespace

Tuning tuning() {
  const std::lock_guard<std::mutex> lock(mutex);
  return current;
}

bool set_tuning(const Tuning& t) {
  const bool ok = t.few >= 0 && t.some >= 0 && t.some <= 1 << 16 && (t.warps == 4 || t.warps == 8 || t.warps == 16) && t.blocks >= 0 && t.blocks <= 1 << 20 &&
                  t.entries >= 1 && t.entries <= 128 && t.queue >= 1 && t.queue <= 1 << 24 && t.threshold >= 0 && t.read_first >= 0 && t.read_first <= 1;
  if (!ok) return false;
  const std::lock_guard<std::mutex> lock(mutex);
  current = t;
  return true;
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
