// Launching: how many blocks a device holds, and scratch memory in parts.
#pragma once

#include <cuda_runtime.h>

#include <utility>

#include "kept_graphs.h"
#include "variant.h"

namespace bigtri {

// Whether a kernel can be launched before the one in front of it has ended: on a device of compute capability 9, and if
// it was compiled for one, so that it waits where it has to.
cudaError_t overlaps_launches(const void* kernel, bool* yes);

// The calling thread's.
cudaError_t current_device(int* device);

// Of the current device.
cudaError_t multiprocessors(int* count);
cudaError_t cache_bytes(int* bytes);  // of its L2 cache

// Lets a kernel's launches on the current device have so much dynamic shared memory; told once per kernel and device.
cudaError_t allow_shared(const void* kernel, int64_t shared_bytes);

// As many blocks of the kernel as the current device holds at once; asked for once per kernel and device. Allows them
// their shared memory.
cudaError_t resident_blocks(const void* kernel, int threads, int64_t shared_bytes, int* blocks);

// Hands out parts of scratch memory, or with no memory only counts.
struct Scratch {
  char* memory;
  int64_t used = 0;

  template <class T>
  T* take(int64_t count) {
    T* part = reinterpret_cast<T*>(memory + used);
    used += (count * (int64_t)sizeof(T) + 255) / 256 * 256;
    return part;
  }
};

// Numbers that a frame's first kernel sets to zero.
struct Zeros {
  uint32_t* first;
  int64_t count;
  // One more, which is set first of all: the next kernel may use it before it waits for this one. Nothing promises that it
  // finds the zero there, so it may stand for nothing that a pixel depends on.
  uint64_t* early = nullptr;

  static Zeros of(uint64_t* first, int count) { return {reinterpret_cast<uint32_t*>(first), 2 * count}; }

  // By thread i of n.
  __device__ __forceinline__ void set(int64_t i, int64_t n) const {
    for (; i < count; i += n) first[i] = 0;
  }
};

namespace {

#define BIGTRI_CUDA(CALL)                     \
  do {                                        \
    const cudaError_t error_ = (CALL);        \
    if (error_ != cudaSuccess) return error_; \
  } while (0)

// Blocks for work that is taken in turns: no more than there is work, and as many as the device holds at once, or
// `wanted` where that is not 0.
template <class Kernel>
cudaError_t blocks_for(Kernel kernel, int threads, int64_t shared_bytes, int64_t work, int64_t wanted, int* blocks) {
  BIGTRI_CUDA(resident_blocks(reinterpret_cast<const void*>(kernel), threads, shared_bytes, blocks));
  if (wanted > 0) *blocks = (int)wanted;
  if (work < *blocks) *blocks = (int)(work < 1 ? 1 : work);
  return cudaSuccess;
}

// Blocks of a grid for `count` things at `each` a block; more than a grid can have take turns. At least one.
inline int64_t grid_blocks(int64_t count, int64_t each) {
  return max_of<int64_t>(1, min_of<int64_t>((count - 1) / each + 1, INT32_MAX));
}

// A kernel of a frame begins while the one in front of it still ends: it may not touch what that one writes before
// wait_for_previous(), which every kernel but a frame's first calls, so that none can overtake the one before last
// either. What the one before last has written it may read at once if the one in front lets it begin only after having
// waited itself: then that was complete in memory before. Zeros::early is an exception.
__device__ __forceinline__ void wait_for_previous() {
#if __CUDA_ARCH__ >= 900
  cudaGridDependencySynchronize();
#endif
}
__device__ __forceinline__ void let_next_begin() {
#if __CUDA_ARCH__ >= 900
  cudaTriggerProgrammaticLaunchCompletion();
#endif
}

// Launches a kernel, with an attribute or none, and answers for this launch; cudaGetLastError might tell of an older
// one of the caller's.
template <class... Parameters, class... Arguments>
cudaError_t launch_with(cudaLaunchAttribute* attribute, void (*kernel)(Parameters...), dim3 blocks, int threads,
                        int64_t shared_bytes, cudaStream_t stream, const Arguments&... arguments) {
  cudaLaunchConfig_t config = {};
  config.gridDim = blocks;
  config.blockDim = dim3((unsigned)threads);
  config.dynamicSmemBytes = (size_t)shared_bytes;
  config.stream = stream;
  config.attrs = attribute;
  config.numAttrs = attribute ? 1 : 0;
  return cudaLaunchKernelEx(&config, kernel, Parameters(arguments)...);
}

// overlaps: whether it may begin while the one in front of it still ends.
template <class... Parameters, class... Arguments>
cudaError_t launch_now(bool overlaps, void (*kernel)(Parameters...), dim3 blocks, int threads, int64_t shared_bytes,
                       cudaStream_t stream, const Arguments&... arguments) {
  cudaLaunchAttribute attribute = {};
  attribute.id = cudaLaunchAttributeProgrammaticStreamSerialization;
  attribute.val.programmaticStreamSerializationAllowed = 1;
  return launch_with(overlaps ? &attribute : nullptr, kernel, blocks, threads, shared_bytes, stream, arguments...);
}

// The same for a launch that was noted, of a kernel whose parameters have these types. kOrder: their numbers.
template <class... Parameters, size_t... kOrder>
cudaError_t launch_noted(const Launch& l, cudaStream_t stream, std::index_sequence<kOrder...>) {
  return launch_now(l.overlaps, reinterpret_cast<void (*)(Parameters...)>(const_cast<void*>(l.kernel)), l.grid.blocks,
                    (int)l.grid.threads, l.grid.shared_bytes, stream,
                    *static_cast<Parameters*>(l.parameters[kOrder])...);
}

template <class... Parameters, class... Arguments>
cudaError_t launch_or_note(bool overlaps, void (*kernel)(Parameters...), dim3 blocks, int threads, int64_t shared_bytes,
                           cudaStream_t stream, const Arguments&... arguments) {
  Launches* const noting = Launches::into(stream);
  if (!noting) return launch_now(overlaps, kernel, blocks, threads, shared_bytes, stream, arguments...);
  Launch l = {};
  l.kernel = reinterpret_cast<const void*>(kernel);
  l.put = [](const Launch& noted, cudaStream_t into) {
    return launch_noted<Parameters...>(noted, into, std::index_sequence_for<Parameters...>());
  };
  l.grid = {blocks, (unsigned)threads, (unsigned)shared_bytes};
  l.overlaps = overlaps;
  return noting->note(l, Parameters(arguments)...);
}

// After all that is in the stream.
template <class Kernel, class... Arguments>
cudaError_t launch_first(Kernel kernel, dim3 blocks, int threads, int64_t shared_bytes, cudaStream_t stream,
                         const Arguments&... arguments) {
  return launch_or_note(false, kernel, blocks, threads, shared_bytes, stream, arguments...);
}

// Behind another kernel of the same frame.
template <class Kernel, class... Arguments>
cudaError_t launch_next(Kernel kernel, dim3 blocks, int threads, int64_t shared_bytes, cudaStream_t stream,
                        const Arguments&... arguments) {
  bool overlap;
  BIGTRI_CUDA(overlaps_launches(reinterpret_cast<const void*>(kernel), &overlap));
  return launch_or_note(overlap, kernel, blocks, threads, shared_bytes, stream, arguments...);
}

// All blocks at once, so that they may wait for each other; an error where they do not fit.
template <class Kernel, class... Arguments>
cudaError_t launch_together(Kernel kernel, dim3 blocks, int threads, int64_t shared_bytes, cudaStream_t stream,
                            const Arguments&... arguments) {
  if (Launches* const noting = Launches::into(stream)) BIGTRI_CUDA(noting->put());  // they come first
  cudaLaunchAttribute attribute = {};
  attribute.id = cudaLaunchAttributeCooperative;
  attribute.val.cooperative = 1;
  return launch_with(&attribute, kernel, blocks, threads, shared_bytes, stream, arguments...);
}

// Draws one view of a frame after the other; on one stream, so that one scratch memory serves them all.
template <class Draw>
cudaError_t each_view(const Frame& f, const Draw& draw) {
  for (int32_t v = 0; v < f.views; ++v) {
    Frame one = view_of(f, v);
    if (one.ranges) {
      const Range range = range_of(one, 0);
      one.triangles += 3 * range.first;
      one.first_triangle = (int32_t)range.first;
      one.count = (int32_t)(range.end - range.first);
      one.ranges = nullptr;
    }
    BIGTRI_CUDA(draw(one));
  }
  return cudaSuccess;
}

// A variant that draws a view at a time, as the registry calls it. kTake(scratch, frame, values) lays out the memory that
// every view uses again; kDraw(frame, values, what kTake gave, stream) draws one.
template <class Values, auto kTake, auto kDraw>
struct ViewByView {
  static int64_t scratch_bytes(const Frame& f, const int64_t* values) {
    int64_t most = 0;
    each_view(f, [&](const Frame& one) {
      Scratch scratch = {nullptr};
      kTake(&scratch, one, Values::of(values));
      most = max_of(most, scratch.used);
      return cudaSuccess;
    });
    return most;
  }
  static cudaError_t draw(const Frame& frame, const int64_t* values, void* memory, cudaStream_t stream) {
    const Values v = Values::of(values);
    return each_view(frame, [&](const Frame& f) {
      Scratch scratch = {static_cast<char*>(memory)};
      return kDraw(f, v, kTake(&scratch, f, v), stream);
    });
  }
};

// The first of the next n places, or `room` where there are none left. The count goes on all the same, in 64 bits, so
// that no number of triangles makes it wrap.
__device__ __forceinline__ uint32_t claim(uint64_t* count, uint32_t room, uint32_t n) {
  return (uint32_t)min_of<uint64_t>(atomicAdd(reinterpret_cast<unsigned long long*>(count), (unsigned long long)n),
                                    room);
}

}  // namespace
}  // namespace bigtri
