// CUDA graphs of what frames launch, kept for the next frame that launches the same kernels.

#include "kept_graphs.h"

#include <cstdlib>
#include <cstring>
#include <list>
#include <mutex>

#include "launch.cuh"

namespace bigtri {
namespace {

thread_local Launches* noting = nullptr;

// Kernels that were launched into a stream together, and their graph from the second time on. Of each stream, because
// two launches of one graph never run at the same time. It has nothing of the stream itself, which may be gone.
struct Kept {
  int device;
  cudaStream_t stream;
  int count;
  const void* kernels[Launches::kMost] = {};
  bool overlaps[Launches::kMost] = {};
  bool refused = false;  // no graph can be made or launched
  cudaGraph_t graph = nullptr;
  cudaGraphExec_t exec = nullptr;
  cudaGraphNode_t nodes[Launches::kMost] = {};

  Kept(int device, cudaStream_t stream, const Launch* launches, int count)
      : device(device), stream(stream), count(count) {
    for (int i = 0; i < count; ++i) {
      kernels[i] = launches[i].kernel;
      overlaps[i] = launches[i].overlaps;
    }
  }

  bool is_same(const Kept& other) const {
    if (device != other.device || stream != other.stream || count != other.count) return false;
    for (int i = 0; i < count; ++i)
      if (kernels[i] != other.kernels[i] || overlaps[i] != other.overlaps[i]) return false;
    return true;
  }

  // A graph that runs ends nevertheless.
  void destroy() {
    if (exec) cudaGraphExecDestroy(exec);
    if (graph) cudaGraphDestroy(graph);
    exec = nullptr;
    graph = nullptr;
  }
};

// The last used ones, the last one first; torch has 32 streams. Nothing destroys them or the list when the process ends:
// the device may be gone by then, and another thread may still draw.
constexpr size_t kMostKept = 128;
std::mutex& mutex = *new std::mutex;
std::list<Kept>& kept = *new std::list<Kept>;

cudaKernelNodeParams node_of(const Launch& launch) {
  cudaKernelNodeParams node = {};
  node.func = const_cast<void*>(launch.kernel);
  node.gridDim = dim3(launch.blocks);
  node.blockDim = dim3(launch.threads);
  node.sharedMemBytes = launch.shared_bytes;
  node.kernelParams = const_cast<void**>(launch.parameters);
  return node;
}

// Lets a node come after another one, as launches into a stream do.
cudaError_t put_behind(cudaGraph_t graph, cudaGraphNode_t front, cudaGraphNode_t node, bool overlaps) {
  cudaGraphEdgeData edge = {};
  if (overlaps) {
    edge.from_port = cudaGraphKernelNodePortProgrammatic;
    edge.type = cudaGraphDependencyTypeProgrammatic;
  }
#if CUDART_VERSION >= 13000
  return cudaGraphAddDependencies(graph, &front, &node, &edge, 1);
#else
  return cudaGraphAddDependencies_v2(graph, &front, &node, &edge, 1);
#endif
}

cudaError_t make_graph(Kept* k, const Launch* launches) {
  BIGTRI_CUDA(cudaGraphCreate(&k->graph, 0));
  for (int i = 0; i < k->count; ++i) {
    const cudaKernelNodeParams node = node_of(launches[i]);
    BIGTRI_CUDA(cudaGraphAddKernelNode(&k->nodes[i], k->graph, nullptr, 0, &node));
    if (i > 0) BIGTRI_CUDA(put_behind(k->graph, k->nodes[i - 1], k->nodes[i], launches[i].overlaps));
  }
  return cudaGraphInstantiate(&k->exec, k->graph, 0);
}

cudaError_t launch_graph(Kept* k, const Launch* launches) {
  if (!k->exec) {
    BIGTRI_CUDA(make_graph(k, launches));
  } else {
    for (int i = 0; i < k->count; ++i) {
      const cudaKernelNodeParams node = node_of(launches[i]);
      BIGTRI_CUDA(cudaGraphExecKernelNodeSetParams(k->exec, k->nodes[i], &node));
    }
  }
  return cudaGraphLaunch(k->exec, k->stream);
}

// Whether what is in no stream yet may go there by a graph: not while the caller captures the stream, for he gets a
// graph himself, and not where each kernel is to be waited for.
bool may_be_graph(cudaStream_t stream) {
  static const char* const blocking = std::getenv("CUDA_LAUNCH_BLOCKING");
  if (blocking && std::strcmp(blocking, "0") != 0) return false;
  cudaStreamCaptureStatus capturing;
  return cudaStreamIsCapturing(stream, &capturing) == cudaSuccess && capturing == cudaStreamCaptureStatusNone;
}

// The calling thread's mode of capturing, as long as it lives.
class Relaxed {
 public:
  Relaxed() { cudaThreadExchangeStreamCaptureMode(&mode_); }
  ~Relaxed() { cudaThreadExchangeStreamCaptureMode(&mode_); }

 private:
  cudaStreamCaptureMode mode_ = cudaStreamCaptureModeRelaxed;
};

// Puts launches into a stream by a graph. False if they are not there: then they have to go one by one, which also says
// what is wrong with them.
bool put_graph(const Launch* launches, int count, cudaStream_t stream) {
  int device;
  if (!may_be_graph(stream) || cudaGetDevice(&device) != cudaSuccess) return false;
  const Kept wanted(device, stream, launches, count);
  const std::lock_guard<std::mutex> lock(mutex);
  // Another thread may be capturing, in the mode that forbids all threads what is unsafe in a capture: this is not in it.
  const Relaxed relaxed;
  auto found = kept.begin();
  while (found != kept.end() && !found->is_same(wanted)) ++found;
  if (found == kept.end()) {  // a graph takes 70 us to make: not for what comes only once
    kept.push_front(wanted);
    if (kept.size() > kMostKept) {
      kept.back().destroy();
      kept.pop_back();
    }
    return false;
  }
  kept.splice(kept.begin(), kept, found);
  if (found->refused) return false;
  if (launch_graph(&*found, launches) == cudaSuccess) return true;
  found->refused = true;
  found->destroy();
  cudaGetLastError();  // clears it
  return false;
}

}  // namespace

Launches::Launches(cudaStream_t stream) : stream_(stream) { noting = this; }
Launches::~Launches() { noting = nullptr; }

Launches* Launches::into(cudaStream_t stream) { return noting && noting->stream_ == stream ? noting : nullptr; }

cudaError_t Launches::put() {
  const int count = count_;
  count_ = 0;
  used_ = 0;
  if (count > 1 && put_graph(launches_, count, stream_)) return cudaSuccess;
  for (int i = 0; i < count; ++i) BIGTRI_CUDA(launches_[i].put(launches_[i], stream_));
  return cudaSuccess;
}

}  // namespace bigtri
