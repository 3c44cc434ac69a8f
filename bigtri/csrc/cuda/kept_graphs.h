// The launches of a frame, put into a stream together by a CUDA graph that is kept: a launch takes the host about 3 us, a
// graph with new parameters 3 us for all of them.
#pragma once

#include <cuda_runtime_api.h>

#include <cstddef>
#include <cstring>
#include <new>
#include <type_traits>

namespace bigtri {

struct Grid {
  dim3 blocks;
  unsigned threads, shared_bytes;
  bool operator==(const Grid& other) const {
    return blocks.x == other.blocks.x && blocks.y == other.blocks.y && blocks.z == other.blocks.z &&
           threads == other.threads && shared_bytes == other.shared_bytes;
  }
};

// A kernel that is not in a stream yet, and where its parameters' values are.
struct Launch {
  static constexpr int kMostParameters = 16;
  const void* kernel;
  cudaError_t (*put)(const Launch& launch, cudaStream_t stream);  // by itself
  Grid grid;
  bool overlaps;  // begins while the one in front of it still ends
  void* parameters[kMostParameters];
  const char* values;  // of all of them, with zeros between them
  size_t value_bytes;
};

// Notes the launches of the calling thread into one stream, as long as it lives. One at a time in a thread; what is not
// put() is not launched.
class Launches {
 public:
  static constexpr int kMost = 8;

  // device: the current one.
  Launches(int device, cudaStream_t stream);
  ~Launches();
  Launches(const Launches&) = delete;
  Launches& operator=(const Launches&) = delete;

  // What notes the calling thread's launches, or null; or only if they go into the stream.
  static Launches* of_thread();
  static Launches* into(cudaStream_t stream);

  int device() const { return device_; }

  // With copies of the parameters' values. Those before are put into the stream where there is no room left.
  template <class... Values>
  cudaError_t note(Launch launch, const Values&... values) {
    static_assert(sizeof...(Values) <= Launch::kMostParameters && (... && std::is_trivially_copyable_v<Values>));
    constexpr size_t bytes = (size_t{0} + ... + room_for<Values>());
    static_assert(bytes <= kBytes);
    if (count_ == kMost || used_ + bytes > kBytes)
      if (const cudaError_t error = put(); error != cudaSuccess) return error;
    launch.values = values_ + used_;
    launch.value_bytes = bytes;
    std::memset(values_ + used_, 0, bytes);
    void** parameter = launch.parameters;
    ((*parameter++ = copy_of(values)), ...);
    launches_[count_++] = launch;
    return cudaSuccess;
  }

  // Puts what is noted into the stream.
  cudaError_t put();

 private:
  static constexpr size_t kBytes = 8192;  // a launch has 4 KB of parameters at most

  template <class T>
  static constexpr size_t room_for() {
    static_assert(alignof(T) <= 16);
    return (sizeof(T) + 15) / 16 * 16;
  }
  template <class T>
  void* copy_of(const T& value) {
    void* const to = values_ + used_;
    used_ += room_for<T>();
    return new (to) T(value);
  }

  int device_;
  cudaStream_t stream_;
  int count_ = 0;
  size_t used_ = 0;
  Launch launches_[kMost];
  alignas(16) char values_[kBytes];
};

// What draw() launches into the stream, together. It may do nothing else with the stream.
template <class Draw>
cudaError_t launch_as_one(cudaStream_t stream, const Draw& draw) {
  int device;
  if (const cudaError_t error = cudaGetDevice(&device); error != cudaSuccess) return error;
  Launches launches(device, stream);
  const cudaError_t error = draw();
  return error == cudaSuccess ? launches.put() : error;
}

}  // namespace bigtri
