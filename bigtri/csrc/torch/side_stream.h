// Work that runs beside a stream's own.
#pragma once

#include <cuda_runtime_api.h>

#include <vector>

#include "cuda.h"

namespace bigtri {

// What is put into stream() runs behind all that is in another stream now, and beside what comes into that one until
// join(): that waits for it, also where an error ends the scope before. A CUDA graph that captures the other stream
// captures this too. The calling thread has one such stream for each device, so that no thread's capture meets another
// thread's work.
class SideStream {
 public:
  SideStream(const char* op, int device, cudaStream_t beside) : op_(op), beside_(beside) {
    static thread_local std::vector<cudaStream_t> of_device;
    if (of_device.size() <= (size_t)device) of_device.resize((size_t)device + 1);
    if (!of_device[(size_t)device])
      check_launch(op, cudaStreamCreateWithFlags(&of_device[(size_t)device], cudaStreamNonBlocking));
    stream_ = of_device[(size_t)device];
    let_wait(stream_, beside_);
  }

  ~SideStream() {
    if (!joined_) wait(beside_, stream_);  // nothing may be told in the midst of an error
  }
  SideStream(const SideStream&) = delete;
  SideStream& operator=(const SideStream&) = delete;

  cudaStream_t stream() const { return stream_; }
  void join() {
    joined_ = true;
    let_wait(beside_, stream_);
  }

 private:
  // Lets a stream wait for all that is in another one now.
  static cudaError_t wait(cudaStream_t waiting, cudaStream_t other) {
    cudaEvent_t event;
    const cudaError_t made = cudaEventCreateWithFlags(&event, cudaEventDisableTiming);
    if (made != cudaSuccess) return made;
    const cudaError_t recorded = cudaEventRecord(event, other),
                      waits = recorded == cudaSuccess ? cudaStreamWaitEvent(waiting, event, 0) : recorded;
    cudaEventDestroy(event);  // when it is no longer needed
    return waits;
  }
  void let_wait(cudaStream_t waiting, cudaStream_t other) const { check_launch(op_, wait(waiting, other)); }

  const char* op_;
  cudaStream_t beside_, stream_;
  bool joined_ = false;
};

}  // namespace bigtri
