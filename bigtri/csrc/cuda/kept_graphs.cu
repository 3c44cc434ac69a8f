// CUDA graphs of what frames launch, kept for the next frame that launches the same kernels.

#include "kept_graphs.h"

#include <cstdlib>
#include <cstring>
#include <list>
#include <mutex>
#include <vector>

#include "launch.cuh"

namespace bigtri {
namespace {

thread_local Launches* noting = nullptr;

// Frames without a graph after its first refusal: each takes the host some 12 us, one that is refused a graph again 70 more.
constexpr int64_t kFirstWait = 64;

// Kernels that were launched into a stream together, and from the second time on a graph of them, with the grids and
// values that it has now. Of each stream, because two launches of one graph never run at the same time. It has nothing of
// the stream itself, which may be gone.
struct Kept {
  int device;
  cudaStream_t stream;
  int count;
  const void* kernels[Launches::kMost] = {};
  bool overlaps[Launches::kMost] = {};
  // Frames that go without a graph, now and after the next refusal. The device may have had no memory for it, and have some
  // later; twice as many after each refusal, so that what is always refused costs next to nothing.
  int64_t wait = 0, next_wait = kFirstWait;
  cudaGraph_t graph = nullptr;
  cudaGraphExec_t exec = nullptr;
  cudaGraphNode_t nodes[Launches::kMost] = {};
  Grid grids[Launches::kMost] = {};
  std::vector<char> values[Launches::kMost];  // of the parameters

  Kept(int device, cudaStream_t stream, const Launch* launches, int count)
      : device(device), stream(stream), count(count) {
    for (int i = 0; i < count; ++i) {
      kernels[i] = launches[i].kernel;
      overlaps[i] = launches[i].overlaps;
    }
  }

  bool is_of(int its_device, cudaStream_t its_stream, const Launch* launches, int its_count) const {
    if (device != its_device || stream != its_stream || count != its_count) return false;
    for (int i = 0; i < count; ++i)
      if (kernels[i] != launches[i].kernel || overlaps[i] != launches[i].overlaps) return false;
    return true;
  }

  // Whether node i launches with the same bytes. Those between the members of a struct may differ where the members do
  // not, which costs time only.
  bool has(const Launch& launch, int i) const {
    return grids[i] == launch.grid && values[i].size() == launch.value_bytes &&
           std::memcmp(values[i].data(), launch.values, launch.value_bytes) == 0;
  }

  void set(const Launch& launch, int i) {
    grids[i] = launch.grid;
    values[i].assign(launch.values, launch.values + launch.value_bytes);
  }

  // How far the graph is from launching the same: a grid takes the driver longer to change than parameters.
  int distance(const Launch* launches) const {
    int d = 0;
    for (int i = 0; i < count; ++i)
      d += has(launches[i], i) ? 0 : grids[i] == launches[i].grid ? 1 : 1 + Launches::kMost;
    return d;
  }

  // No graph could be made or launched.
  void refuse() {
    destroy();
    wait = next_wait;
    next_wait *= 2;
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
// Graphs of the same kernels in a stream. A loop that lets a result go when it has the next one gets memory for it in
// turns from two places, and so a graph for each, which is launched as it is.
constexpr int kMostAlike = 4;
std::mutex& mutex = *new std::mutex;
std::list<Kept>& kept = *new std::list<Kept>;

cudaKernelNodeParams node_of(const Launch& launch) {
  cudaKernelNodeParams node = {};
  node.func = const_cast<void*>(launch.kernel);
  node.gridDim = launch.grid.blocks;
  node.blockDim = dim3(launch.grid.threads);
  node.sharedMemBytes = launch.grid.shared_bytes;
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
    k->set(launches[i], i);
    if (i > 0) BIGTRI_CUDA(put_behind(k->graph, k->nodes[i - 1], k->nodes[i], launches[i].overlaps));
  }
  return cudaGraphInstantiate(&k->exec, k->graph, 0);
}

cudaError_t launch_graph(Kept* k, const Launch* launches) {
  if (!k->exec) {
    BIGTRI_CUDA(make_graph(k, launches));
  } else {
    for (int i = 0; i < k->count; ++i) {
      if (k->has(launches[i], i)) continue;
      const cudaKernelNodeParams node = node_of(launches[i]);
      BIGTRI_CUDA(cudaGraphExecKernelNodeSetParams(k->exec, k->nodes[i], &node));
      k->set(launches[i], i);
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

// The graph to launch them by: one of the same kernels that has nothing to change; else a new one while there may be more
// of them; else the one with the least to change, and of several the one used longest ago. Null where they come for the
// first time, for a graph takes 70 us to make, or while one that was refused is not tried again.
Kept* graph_for(int device, cudaStream_t stream, const Launch* launches, int count) {
  auto best = kept.end();
  int alike = 0, least = 0;
  for (auto k = kept.begin(); k != kept.end() && alike < kMostAlike; ++k) {
    if (!k->is_of(device, stream, launches, count)) continue;
    if (k->wait > 0) {
      --k->wait;
      return nullptr;
    }
    const int distance = k->exec ? k->distance(launches) : 0;
    if (alike++ == 0 || distance <= least) {
      best = k;
      least = distance;
    }
    if (least == 0) break;
  }
  if (alike > 0 && (least == 0 || alike == kMostAlike)) {
    kept.splice(kept.begin(), kept, best);
    return &*best;
  }
  kept.emplace_front(device, stream, launches, count);
  if (kept.size() > kMostKept) {
    kept.back().destroy();
    kept.pop_back();
  }
  return alike > 0 ? &kept.front() : nullptr;
}

// Puts launches into a stream by a graph. False if they are not there: then they have to go one by one, which also says
// what is wrong with them.
bool put_graph(int device, cudaStream_t stream, const Launch* launches, int count) {
  if (!may_be_graph(stream)) return false;
  const std::lock_guard<std::mutex> lock(mutex);
  // Another thread may be capturing, in the mode that forbids all threads what is unsafe in a capture: this is not in it.
  const Relaxed relaxed;
  Kept* const graph = graph_for(device, stream, launches, count);
  if (!graph) return false;
  if (launch_graph(graph, launches) == cudaSuccess) return true;
  graph->refuse();
  cudaGetLastError();  // clears it
  return false;
}

}  // namespace

Launches::Launches(int device, cudaStream_t stream) : device_(device), stream_(stream) { noting = this; }
Launches::~Launches() { noting = nullptr; }

Launches* Launches::of_thread() { return noting; }

Launches* Launches::into(cudaStream_t stream) { return noting && noting->stream_ == stream ? noting : nullptr; }

cudaError_t Launches::put() {
  const int count = count_;
  count_ = 0;
  used_ = 0;
  if (count > 1 && put_graph(device_, stream_, launches_, count)) return cudaSuccess;
  for (int i = 0; i < count; ++i) BIGTRI_CUDA(launches_[i].put(launches_[i], stream_));
  return cudaSuccess;
}

}  // namespace bigtri
