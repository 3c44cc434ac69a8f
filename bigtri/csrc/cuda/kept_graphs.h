// The launches of a frame, put into a stream together by a CUDA graph that is kept: a launch takes the host about 3 us, a
// graph with new parameters 3 us for all of them.
#pragma once

#include <cuda_runtime_api.h>

#include <cstddef>
#include <new>
#include <type_traits>

namespace bigtri {

// A kernel that is not in a stream yet, and where its parameters' values are.
struct Launch {
  static constexpr int kMostParameters = 16;
  const void* kernel;
  cudaError_t (*put)(const Launch& launch, cudaStream_t stream);  // by itself
  unsigned blocks, threads, shared_bytes;
  bool overlaps;  // begins while the one in front of it still ends
  void* parameters[kMostParameters];
};

// Notes the launches of the calling thread into one stream, as long as it lives. One at a time in a thread; what is not
// put() is not launched.
class Launches {
 public:
  static constexpr int kMost = 8;

  explicit Launches(cudaStream_t stream);
  ~Launches();
  Launches(const Launches&) = delete;
  Launches& operator=(const Launches&) = delete;

  // What notes the calling thread's launches into the stream, or null.
  static Launches* into(cudaStream_t stream);

  // With copies of the parameters' values. Those before are put into the stream where there is no room left.
  template <class... Values>
  cudaError_t note(Launch launch, const Values&... values) {
    static_assert(sizeof...(Values) <= Launch::kMostParameters && (... && std::is_trivially_copyable_v<Values>));
    constexpr size_t bytes = (size_t{0} + ... + room_for<Values>());
    static_assert(bytes <= kBytes);
    if (count_ == kMost || used_ + bytes > kBytes)
      if (const cudaError_t error = put(); error != cudaSuccess) return error;
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

  cudaStream_t stream_;
  int count_ = 0;
  size_t used_ = 0;
  Launch launches_[kMost];
  alignas(16) char values_[kBytes];
};

// What draw() launches into the stream, together. It may do nothing else with the stream.
template <class Draw>
cudaError_t launch_as_one(cudaStream_t stream, const Draw& draw) {
  Launches launches(stream);
  const cudaError_t error = draw();
  return error == cudaSuccess ? launches.put() : error;
}

}  // namespace bigtri
