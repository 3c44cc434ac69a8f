// Runs CUDA kernels on the CPU: a block at a time, each of its threads with a stack of its own, one after the other
// from barrier to barrier. Memory of the "device" ends at a page that cannot be touched. What no GPU would survive ends
// the process with a message: access beyond memory, barriers that not all threads reach, or different ones. Kernels run
// one after the other, so what goes wrong only where they overlap does not show.

#include "cuda_on_cpu.h"

#include <signal.h>
#include <stdio.h>
#include <sys/mman.h>
#include <unistd.h>

#include <list>
#include <vector>

#include "../core/numerics.h"
#include "areas.h"
#include "attributes.h"
#include "shade.h"
#include "shading.h"
#include "transform.h"
#include "variant.h"

namespace bigtri {
namespace BIGTRI_NAMESPACE {
extern const CudaVariant* const kCudaVariants[];
}
namespace BIGTRI_RUNG {
cudaError_t interpolate_cuda(const Interpolation& job, cudaStream_t stream);
int64_t shading_scratch(const Shading& job);
bool shades_areas(const Shading& job);
cudaError_t begin_shading_cuda(const Shading& job, void* scratch, cudaStream_t stream);
cudaError_t shade_cuda(const Shading& job, void* scratch, cudaStream_t stream);
}  // namespace BIGTRI_RUNG
}  // namespace bigtri

uint3 threadIdx, blockIdx;
dim3 blockDim, gridDim;
char* dynamic_shared;

// Leaves one stack for another: x86-64, System V.
extern "C" void switch_stack(void** left, void* to);
asm(R"(
.text
.globl switch_stack
switch_stack:
  push %rbp
  push %rbx
  push %r12
  push %r13
  push %r14
  push %r15
  mov %rsp, (%rdi)
  mov %rsi, %rsp
  pop %r15
  pop %r14
  pop %r13
  pop %r12
  pop %rbx
  pop %rbp
  ret
)");

namespace {

constexpr int kWarp = 32, kMostThreads = 1024;
constexpr int kProcessors[] = {2, 8};  // of each device
constexpr size_t kStackBytes = 256 << 10, kPage = 4096;

struct Thread {
  void* at = nullptr;  // where its stack was left
  const char* file = nullptr;
  int line = 0;
  int meetings = 0;  // of its warp
};

// A bit for each lane says what it does. The lines are those of the first lane that waits.
struct Warp {
  uint32_t lanes, ready, at_warp, done;
  int line, stray;  // a lane that meets elsewhere, or -1
  // What the lanes brought, last time and the time before: a lane may be one meeting ahead of another.
  uint64_t values[2][kWarp];
  uint32_t votes[2];  // which of these are not 0
};

Thread threads[kMostThreads];
Warp warps[kMostThreads / kWarp];
int current, at_block, done, block_line, stray_thread, sum, next_sum;
uint32_t to_run;  // lanes of the warp that runs whose turn is still to come
bool from_last;  // whether the last of them is the next
// Of threads between barriers: the first one first, the last one first, or in turns, each to the next barrier of its
// warp or block; or a warp as far as it gets before the next one runs, the first or the last warp first. What depends
// on it lacks a barrier.
enum Order { kForward, kBackward, kInTurns, kWarpForward, kWarpBackward };
int order = kForward;
void* scheduler;
const std::function<void()>* body;
int kernel;  // how many the frame has had

[[noreturn]] void fail(const char* what, int thread) {
  const Thread& t = threads[thread];
  fprintf(stderr,
          "cuda_on_cpu: %s: kernel %d of the frame, block (%u, %u, %u) of (%u, %u, %u), thread %d of %u, at %s:%d\n",
          what, kernel, blockIdx.x, blockIdx.y, blockIdx.z, gridDim.x, gridDim.y, gridDim.z, thread, blockDim.x,
          t.file ? t.file : "its start", t.line);
  _exit(2);
}

void on_fault(int) { fail("access beyond memory", current); }

// Threads have no room for a handler on their stacks, so it has one of its own.
void handle_faults() {
  static bool handled = false;
  if (!handled) {
    static char stack[1 << 16];
    const stack_t alternative = {stack, 0, sizeof stack};
    sigaltstack(&alternative, nullptr);
    struct sigaction action = {};
    action.sa_handler = on_fault;
    action.sa_flags = SA_ONSTACK;
    sigaction(SIGSEGV, &action, nullptr);
    sigaction(SIGBUS, &action, nullptr);
    handled = true;
  }
}

// Leaves a thread's stack for that of the next lane of its warp, or for the scheduler's after the last one.
void leave(void** left) {
  if (!to_run) return switch_stack(left, scheduler);
  const int lane = from_last ? 31 - __builtin_clz(to_run) : __builtin_ctz(to_run);
  to_run &= ~(1u << lane);
  current = current / kWarp * kWarp + lane;
  threadIdx.x = (unsigned)current;
  switch_stack(left, threads[current].at);
}

void thread_main() {
  (*body)();
  warps[current / kWarp].done |= 1u << current % kWarp;
  ++done;
  void* left;
  leave(&left);
  abort();
}

void wait(const char* file, int line) {
  Thread& t = threads[current];
  t.file = file;
  t.line = line;
  leave(&t.at);
}

void start(int thread) {
  // Threads take turns, and a cache holds more of the stacks' ends if these are not all equally far into a page.
  constexpr size_t kStride = kStackBytes + kPage + 320;
  static char* const stacks = static_cast<char*>(mmap(nullptr, kMostThreads * kStride, PROT_READ | PROT_WRITE,
                                                      MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0));
  void** top = reinterpret_cast<void**>(stacks + thread * kStride + kStackBytes);
  *--top = nullptr;
  *--top = reinterpret_cast<void*>(thread_main);
  for (int saved = 0; saved < 6; ++saved) *--top = nullptr;
  threads[thread] = {top};
}

// Lets the lanes of a warp go on if all have come to the same place; false if they have not.
bool release_warp(int warp) {
  Warp& w = warps[warp];
  if (!w.at_warp) return false;
  if (w.done) fail("a lane has ended where its warp meets", warp * kWarp + __builtin_ctz(w.done));
  if (w.at_warp != w.lanes) return false;
  if (w.stray >= 0) fail("lanes meet at different places", w.stray);
  w.votes[threads[warp * kWarp].meetings & 1] = 0;  // all have read those of the meeting before
  w.at_warp = 0;
  w.ready = w.lanes;
  return true;
}

bool release_block(int count) {
  if (at_block != count) return false;
  if (stray_thread >= 0) fail("threads meet at different barriers", stray_thread);
  sum = next_sum;
  at_block = next_sum = 0;
  for (int warp = 0; warp * kWarp < count; ++warp) warps[warp].ready = warps[warp].lanes;
  return true;
}

// Runs those of a warp's threads that are ready, each to its next barrier; whether there were any.
bool run_warp(int warp, bool backward) {
  if (!warps[warp].ready) return false;
  to_run = warps[warp].ready;
  warps[warp].ready = 0;
  from_last = backward;
  current = warp * kWarp;
  leave(&scheduler);
  return true;
}

void run_block(int count) {
  const int used = (count + kWarp - 1) / kWarp;
  for (int i = 0; i < count; ++i) start(i);
  for (int warp = 0; warp < used; ++warp) {
    warps[warp] = {};
    warps[warp].lanes = warps[warp].ready = ~0u >> (warp == used - 1 ? used * kWarp - count : 0);
  }
  at_block = done = next_sum = 0;
  for (int pass = 0;; ++pass) {
    bool moved = false;
    const bool backward = order == kBackward || (order == kInTurns && pass % 2 == 1);
    for (int n = 0; n < used; ++n) {
      const int warp = backward || order == kWarpBackward ? used - 1 - n : n;
      if (order == kWarpForward || order == kWarpBackward) {
        do moved = run_warp(warp, false) || moved;
        while (release_warp(warp));
      } else {
        moved = run_warp(warp, backward) || moved;
      }
    }
    if (order != kWarpForward && order != kWarpBackward)
      for (int warp = 0; warp < used; ++warp) moved = release_warp(warp) || moved;
    if (done == count) return;
    if (!release_block(count) && !moved) fail("not all threads reach a barrier", 0);
  }
}

// Memory that ends where it may not be touched. What was given back last comes first, so that frames of a size have the
// same addresses; and new pages would cost more than to fill old ones.
class Memory {
 public:
  Memory(size_t bytes, int fill) : bytes_((bytes + 15) / 16 * 16), pages_((bytes_ + kPage - 1) / kPage * kPage) {
    if (const auto after = left_.upper_bound(pages_); after != left_.begin() && std::prev(after)->first == pages_) {
      base_ = left_.extract(std::prev(after)).mapped();
      mprotect(base_ + kPage, pages_, PROT_READ | PROT_WRITE);
    } else {
      base_ = static_cast<char*>(
          mmap(nullptr, pages_ + 2 * kPage, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0));
      mprotect(base_, kPage, PROT_NONE);
      mprotect(base_ + kPage + pages_, kPage, PROT_NONE);
    }
    memset(base_ + kPage, fill, pages_);
  }
  Memory(const Memory&) = delete;
  ~Memory() {
    mprotect(base_ + kPage, pages_, PROT_NONE);  // a pointer to it that is left somewhere points to nothing
    left_.emplace(pages_, base_);
    if (left_.size() <= kMostLeft) return;
    const auto largest = std::prev(left_.end());
    munmap(largest->second, largest->first + 2 * kPage);
    left_.erase(largest);
  }
  template <class T>
  T* of() const {
    return reinterpret_cast<T*>(base_ + kPage + pages_ - bytes_);
  }

 private:
  static constexpr size_t kMostLeft = 16;
  static inline std::multimap<size_t, char*> left_;
  size_t bytes_, pages_;
  char* base_;
};

// The same with what the host has at `from`.
template <class T>
struct Copied : Memory {
  Copied(const T* from, size_t count) : Memory(count * sizeof(T), 0) {
    if (count) memcpy(of<T>(), from, count * sizeof(T));
  }
  const T* get() const { return of<T>(); }
};

const bigtri::CudaVariant* find_variant(const char* name) {
  const bigtri::CudaVariant* const* v = bigtri::BIGTRI_NAMESPACE::kCudaVariants;
  while (*v && strcmp((*v)->name, name) != 0) ++v;
  return *v;
}

// sample_on_cpu for one type of values.
template <class Code>
int sample_values(const Code* texture, const float* uv, const int64_t* sizes, float* out) {
  using namespace bigtri;
  handle_faults();
  const Copied<Code> texels(texture, sizes[0] * sizes[1] * sizes[2]);
  const Copied<float> coordinates(uv, 2 * sizes[3]);
  const Memory result(sizes[3] * sizes[2] * 4, 0x33);
  kernel = 0;
  const cudaError_t error = sample_cuda(texels.get(), (int)sizes[0], (int)sizes[1], sizes[2], coordinates.get(),
                                        sizes[3], (Filter)sizes[4], (Wrap)sizes[5], result.of<float>(), nullptr);
  memcpy(out, result.of<float>(), sizes[3] * sizes[2] * 4);
  return error;
}

}  // namespace

// Waits until the whole warp has come, with the value of each lane; which of its last two meetings it was.
static int meet(uint64_t value, const char* file, int line) {
  Warp& w = warps[current / kWarp];
  const int lane = current % kWarp, meeting = threads[current].meetings++ & 1;
  if (!w.at_warp) w.line = line, w.stray = -1;
  if (w.line != line) w.stray = current;
  w.at_warp |= 1u << lane;
  w.values[meeting][lane] = value;
  w.votes[meeting] |= (value != 0 ? 1u : 0u) << lane;
  wait(file, line);
  return meeting;
}

const uint64_t* warp_values(uint64_t value, const char* file, int line) {
  const Warp& w = warps[current / kWarp];
  return w.values[meet(value, file, line)];
}

unsigned warp_votes(bool value, const char* file, int line) {
  const Warp& w = warps[current / kWarp];
  return w.votes[meet(value, file, line)];
}

int block_sum(int value, const char* file, int line) {
  if (at_block++ == 0) block_line = line, stray_thread = -1;
  if (block_line != line) stray_thread = current;
  next_sum += value;
  wait(file, line);
  return sum;
}

void run_grid(dim3 grid, dim3 block, size_t shared_bytes, const std::function<void()>& what) {
  if (block.x > kMostThreads) abort();
  const Memory shared(shared_bytes, 0);
  ++kernel;
  body = &what;
  gridDim = grid;
  blockDim = block;
  dynamic_shared = shared.of<char>();
  for (uint64_t number = 0; number < (uint64_t)grid.x * grid.y * grid.z; ++number) {
    const uint64_t row = number / grid.x;
    blockIdx = {(unsigned)(number % grid.x), (unsigned)(row % grid.y), (unsigned)(row / grid.y)};
    memset(dynamic_shared, 0xcd, shared_bytes);
    run_block((int)block.x);
  }
}

std::map<const void*, Bind> kernels_seen;

// Bytes of dynamic shared memory that a kernel may have, where they are not 48 KB.
static std::map<const void*, int> most_shared;
static int shared_allowed = 0;

bool may_have(const void* kernel, size_t shared_bytes) {
  const auto most = most_shared.find(kernel);
  return shared_bytes <= (most == most_shared.end() ? 48 * 1024 : (size_t)most->second);
}

// Graphs are rows of kernels that were launched before; what cannot be in one is refused.
struct CUgraphNode_st {
  size_t place;
};
struct CUgraph_st {
  std::list<CUgraphNode_st> nodes;
  std::vector<cudaKernelNodeParams> kernels;
  std::vector<std::function<void()>> bodies;
  size_t edges = 0;

  void set(size_t place, const cudaKernelNodeParams& kernel) {
    kernels[place] = kernel;
    bodies[place] = kernels_seen.at(kernel.func)(kernel.kernelParams);
  }
};
struct CUgraphExec_st : CUgraph_st {};
static int graphs_launched = 0, graphs_made = 0, nodes_set = 0, refusing = 0;
static int device_in_use = 0;

// Devices of few multiprocessors with room for a block each, so that blocks take several turns; of an old kind, so that
// launches do not overlap.
extern "C" {
cudaError_t cudaStreamIsCapturing(cudaStream_t, cudaStreamCaptureStatus* status) {
  *status = cudaStreamCaptureStatusNone;
  return cudaSuccess;
}
cudaError_t cudaThreadExchangeStreamCaptureMode(cudaStreamCaptureMode*) { return cudaSuccess; }
cudaError_t cudaGetLastError() { return cudaSuccess; }
cudaError_t cudaGraphCreate(cudaGraph_t* graph, unsigned) {
  *graph = new CUgraph_st;
  return cudaSuccess;
}
cudaError_t cudaGraphDestroy(cudaGraph_t graph) {
  delete graph;
  return cudaSuccess;
}
cudaError_t cudaGraphAddKernelNode(cudaGraphNode_t* node, cudaGraph_t graph, const cudaGraphNode_t*, size_t,
                                   const cudaKernelNodeParams* kernel) {
  graph->nodes.push_back({graph->kernels.size()});
  graph->kernels.emplace_back();
  graph->bodies.emplace_back();
  graph->set(graph->nodes.back().place, *kernel);
  *node = &graph->nodes.back();
  return cudaSuccess;
}
#if CUDART_VERSION < 13000
#define cudaGraphAddDependencies cudaGraphAddDependencies_v2
#endif
cudaError_t cudaGraphAddDependencies(cudaGraph_t graph, const cudaGraphNode_t* from, const cudaGraphNode_t* to,
                                     const cudaGraphEdgeData* edge, size_t count) {
  ++graph->edges;
  return count == 1 && (*from)->place + 1 == (*to)->place && edge->type == 0 ? cudaSuccess : cudaErrorInvalidValue;
}
cudaError_t cudaGraphInstantiate(cudaGraphExec_t* exec, cudaGraph_t graph, unsigned long long) {
  if (graph->edges + 1 != graph->nodes.size()) return cudaErrorInvalidValue;
  if (refusing > 0) {
    --refusing;
    return cudaErrorMemoryAllocation;
  }
  ++graphs_made;
  *exec = new CUgraphExec_st{*graph};
  return cudaSuccess;
}
cudaError_t cudaGraphExecDestroy(cudaGraphExec_t exec) {
  delete exec;
  return cudaSuccess;
}
cudaError_t cudaGraphExecKernelNodeSetParams(cudaGraphExec_t exec, cudaGraphNode_t node,
                                             const cudaKernelNodeParams* kernel) {
  ++nodes_set;
  exec->set(node->place, *kernel);
  return cudaSuccess;
}
cudaError_t cudaGraphLaunch(cudaGraphExec_t exec, cudaStream_t) {
  ++graphs_launched;
  for (size_t i = 0; i < exec->kernels.size(); ++i)
    if (!may_be(exec->kernels[i].gridDim)) return cudaErrorInvalidConfiguration;
  for (size_t i = 0; i < exec->kernels.size(); ++i)
    run_grid(exec->kernels[i].gridDim, exec->kernels[i].blockDim, exec->kernels[i].sharedMemBytes, exec->bodies[i]);
  return cudaSuccess;
}
cudaError_t cudaGetDevice(int* device) {
  *device = device_in_use;
  return cudaSuccess;
}
cudaError_t cudaDeviceGetAttribute(int* value, cudaDeviceAttr attribute, int device) {
  *value = attribute == cudaDevAttrMultiProcessorCount ? kProcessors[device]
           : attribute == cudaDevAttrL2CacheSize       ? 1 << 20
                                                       : 7;
  return cudaSuccess;
}
cudaError_t cudaFuncGetAttributes(cudaFuncAttributes* attributes, const void*) {
  *attributes = {};
  return cudaSuccess;
}
cudaError_t cudaFuncSetAttribute(const void* function, cudaFuncAttribute attribute, int value) {
  if (attribute != cudaFuncAttributeMaxDynamicSharedMemorySize) return cudaErrorInvalidValue;
  most_shared[function] = value;
  ++shared_allowed;
  return cudaSuccess;
}
cudaError_t cudaOccupancyMaxActiveBlocksPerMultiprocessor(int* blocks, const void*, int, size_t) {
  *blocks = 1;
  return cudaSuccess;
}
cudaError_t cudaMemsetAsync(void* p, int value, size_t bytes, cudaStream_t) {
  memset(p, value, bytes);
  return cudaSuccess;
}
void set_order(int v) { order = v; }
void use_device(int device) { device_in_use = device; }
int launched_graphs() { return graphs_launched; }
int made_graphs() { return graphs_made; }
int set_nodes() { return nodes_set; }
// The next graphs, as if there were no memory for them; how many of these have not come yet.
void refuse_graphs(int count) { refusing = count; }
int graphs_to_refuse() { return refusing; }
int times_allowed() { return shared_allowed; }  // that a kernel may have more shared memory

// Of parameter i of a variant: its name, or null where there is none; its standard, lowest and highest value; the
// values allowed, ending with -1, or null for all.
const char* parameter_name(const char* variant, int i) {
  const bigtri::CudaVariant* v = find_variant(variant);
  return v ? v->parameters[i].name : nullptr;
}
const int64_t* parameter_range(const char* variant, int i) { return &find_variant(variant)->parameters[i].standard; }
const int64_t* parameter_only(const char* variant, int i) { return find_variant(variant)->parameters[i].only; }

// One image for each of `views`; view: width, height, scissor x0 y0 x1 y1, cull. depth may be null. ranges: of each view,
// which then share the positions, or null. 0, or what was refused.
int draw_on_cpu(const char* variant, int32_t views, const float* positions, int64_t vertices, const int32_t* triangles,
                int32_t count, const int32_t* ranges, const int32_t* view, const int64_t* values, int64_t* packed,
                float* depth, int64_t* dropped, const bigtri::CountedWork* counted) {
  using namespace bigtri;
  handle_faults();
  const CudaVariant* chosen = find_variant(variant);
  if (!chosen) return 1;
  for (int i = 0; chosen->parameters[i].name; ++i)
    if (!chosen->parameters[i].allows(values[i])) return 2;
  const size_t pixels = (size_t)views * view[0] * view[1];
  const size_t given = (ranges ? 1 : views) * vertices * 16;
  const Memory p(given, 0), t((size_t)count * 12, 0), image(pixels * 8, 0x33), depths(pixels * 4, 0x33),
      drops(views * 8, 0x33);
  if (given) memcpy(p.of<float>(), positions, given);
  if (count) memcpy(t.of<int32_t>(), triangles, (size_t)count * 12);
  Frame f = {};
  f.positions = p.of<float>();
  f.triangles = t.of<int32_t>();
  f.vertices = vertices;
  f.view_stride = ranges ? 0 : vertices * 4;
  f.ranges = ranges;
  f.count = count;
  f.views = views;
  f.view = {view[0], view[1], view[2], view[3], view[4], view[5], view[6]};
  f.packed = image.of<int64_t>();
  f.depth = depth ? depths.of<float>() : nullptr;
  f.dropped = drops.of<int64_t>();
  f.counted = counted;
  kernel = 0;
  const Memory scratch(chosen->scratch_bytes(f, values), 0x7f);
  if (chosen->draw(f, values, scratch.of<char>(), nullptr) != cudaSuccess) return 3;
  memcpy(packed, f.packed, pixels * 8);
  if (depth) memcpy(depth, f.depth, pixels * 4);
  memcpy(dropped, f.dropped, views * 8);
  return 0;
}

// Interpolation in the rung; 0, or what the launch said. sizes: views, height, width, vertices of a view, triangles,
// channels, and views of the attributes, or 0 for the weights.
int interpolate_on_cpu(const int64_t* packed, const float* positions, const int32_t* triangles, const float* attributes,
                       const int64_t* sizes, float* out) {
  using namespace bigtri;
  handle_faults();
  const int64_t views = sizes[0], pixels = sizes[1] * sizes[2], vertices = sizes[3], channels = sizes[5];
  const Copied<int64_t> buffer(packed, views * pixels);
  const Copied<float> clip_space(positions, views * vertices * 4), given(attributes, sizes[6] * vertices * channels);
  const Copied<int32_t> indices(triangles, sizes[4] * 3);
  const Memory result(views * pixels * channels * 4, 0x33),
      scratch(interpolation_scratch(views, sizes[1], sizes[2]), 0x7f);
  Interpolation job = {};
  job.packed = buffer.get();
  job.positions = clip_space.get();
  job.triangles = indices.get();
  job.attributes = sizes[6] * vertices > 0 ? given.get() : nullptr;
  job.weights = sizes[6] == 0;
  job.out = result.of<float>();
  job.clipped = scratch.of<uint32_t>();
  job.batch = views;
  job.vertices = vertices;
  job.position_view = vertices * 4;
  job.attribute_view = sizes[6] == 1 ? 0 : vertices * channels;
  job.channels = channels;
  job.count = (int32_t)sizes[4];
  job.height = (int)sizes[1];
  job.width = (int)sizes[2];
  kernel = 0;
  const cudaError_t error = BIGTRI_RUNG::interpolate_cuda(job, nullptr);
  memcpy(out, job.out, views * pixels * channels * 4);
  return error;
}

// bytes: of a value of the texture, which is float, uint8_t or uint16_t. sizes: of the texture, height, width and
// channels; coordinates; filter; wrap.
int sample_on_cpu(const void* texture, int64_t bytes, const float* uv, const int64_t* sizes, float* out) {
  if (bytes == 1) return sample_values(static_cast<const uint8_t*>(texture), uv, sizes, out);
  if (bytes == 2) return sample_values(static_cast<const uint16_t*>(texture), uv, sizes, out);
  return sample_values(static_cast<const float*>(texture), uv, sizes, out);
}

int lambert_on_cpu(const float* normals, const float* albedo, const float* ambient, const float* directions,
                   const float* colors, int64_t lights, int64_t count, float* out) {
  using namespace bigtri;
  handle_faults();
  const Copied<float> n(normals, 3 * count), a(albedo, 3 * count), everywhere(ambient, 3),
      to_light(directions, 3 * lights), of_light(colors, 3 * lights);
  const Memory result(12 * count, 0x33);
  kernel = 0;
  const cudaError_t error = lambert_cuda(n.get(), a.get(), everywhere.get(), to_light.get(), of_light.get(), lights,
                                         count, result.of<float>(), nullptr);
  memcpy(out, result.of<float>(), 12 * count);
  return error;
}

int encode_on_cpu(const float* linear, const float* thresholds, int64_t count, uint8_t* out) {
  using namespace bigtri;
  handle_faults();
  const Copied<float> numbers(linear, count);
  const Memory result(count, 0x33);
  kernel = 0;
  const cudaError_t error = encode_srgb_cuda(numbers.get(), thresholds, count, result.of<uint8_t>(), nullptr);
  memcpy(out, result.of<uint8_t>(), count);
  return error;
}

int transform_on_cpu(const float* points, const double* matrices, int64_t count, int64_t views, float* out) {
  using namespace bigtri;
  handle_faults();
  const Copied<float> p(points, 3 * count);
  const Copied<double> m(matrices, 16 * views);
  const Memory result(16 * views * count, 0x33);
  kernel = 0;
  const cudaError_t error = transform_cuda(p.get(), m.get(), count, views, result.of<float>(), nullptr);
  memcpy(out, result.of<float>(), 16 * views * count);
  return error;
}

// What shade_on_cpu gets. Arrays are those of the operators `shade` and `draw`; null: left out.
struct PictureOnCpu {
  int64_t views, height, width, samples, channels, vertices, triangles, materials, textures, lights, two_sided, cull;
  const void* packed;  // null: the triangles are drawn first; and into memory that is nobody's, if drawn is null too
  const void *positions, *indices, *uvs, *colors, *normals, *face_normals, *material, *looks, *base_colors,
      *light_directions, *light_colors;
  const float *constants, *thresholds;
  const void* const* texels;  // of each texture
  const int64_t* texture_size;  // of each texture: height, width, bytes of a value
  void *image, *albedo, *normal_image, *linear, *drawn, *depth, *dropped;
};

// The shading pass, of a buffer or of triangles, in the rung; 0, or what the launch said.
int shade_on_cpu(const PictureOnCpu* p) {
  using namespace bigtri;
  handle_faults();
  std::list<Memory> memory;
  const auto given = [&](const void* from, int64_t bytes) -> const void* {
    if (!from) return nullptr;
    memory.emplace_back((size_t)bytes, 0);
    if (bytes) memcpy(memory.back().of<char>(), from, (size_t)bytes);
    return memory.back().of<char>();
  };
  struct Output {
    void *to, *from;
    int64_t bytes;
  };
  std::list<Output> outputs;
  const auto output = [&](void* to, int64_t bytes) -> void* {
    if (!to) return nullptr;
    memory.emplace_back((size_t)bytes, 0x33);
    outputs.push_back({to, memory.back().of<char>(), bytes});
    return memory.back().of<char>();
  };
  const int64_t samples = p->views * p->height * p->width, pixels = samples / (p->samples * p->samples);
  const auto floats = [&](const void* from, int64_t count) { return (const float*)given(from, 4 * count); };
  Shading job = {};
  Surface& s = job.surface;
  std::vector<Texture> textures;
  for (int64_t i = 0; i < p->textures; ++i) {
    const int64_t* size = p->texture_size + 3 * i;
    textures.push_back({given(p->texels[i], size[0] * size[1] * 3 * size[2]), (int32_t)size[0], (int32_t)size[1],
                        size[2] == 1   ? Texels::kCodes8
                        : size[2] == 2 ? Texels::kCodes16
                                       : Texels::kLinear});
  }
  job.packed = (const int64_t*)given(p->packed, 8 * samples);
  job.positions = floats(p->positions, p->views * p->vertices * 4);
  job.triangles = (const int32_t*)given(p->indices, 12 * p->triangles);
  s.uvs = floats(p->uvs, 2 * p->vertices);
  s.colors = floats(p->colors, 3 * p->vertices);
  s.normals = floats(p->normals, 3 * p->vertices);
  s.face_normals = floats(p->face_normals, 3 * p->triangles);
  s.material = (const int32_t*)given(p->material, 4 * p->triangles);
  s.looks = (const Look*)given(p->looks, 8 * p->materials);
  s.base_colors = floats(p->base_colors, 3 * p->materials);
  s.textures = textures.data();
  s.materials = (int32_t)p->materials;
  s.texture_count = (int32_t)p->textures;
  s.two_sided = p->two_sided != 0;
  s.light_directions = floats(p->light_directions, 3 * p->lights);
  s.light_colors = floats(p->light_colors, 3 * p->lights);
  s.lights = p->lights;
  memcpy(s.ambient, p->constants, 12);
  memcpy(s.top, p->constants + 3, 12);
  memcpy(s.bottom, p->constants + 6, 12);
  job.thresholds = p->thresholds;
  job.image = (uint8_t*)output(p->image, pixels * p->channels);
  job.albedo = (float*)output(p->albedo, 12 * samples);
  job.normals = (float*)output(p->normal_image, 12 * samples);
  job.linear = (float*)output(p->linear, 12 * samples);
  job.views = p->views;
  job.vertices = p->vertices;
  job.count = (int32_t)p->triangles;
  job.height = (int)p->height;
  job.width = (int)p->width;
  job.samples = (int)p->samples;
  job.channels = (int)p->channels;
  kernel = 0;
  const Memory scratch((size_t)BIGTRI_RUNG::shading_scratch(job), 0x7f);
  const Memory buffer((size_t)(p->packed || p->drawn ? 0 : 8 * samples), 0);  // triangle 0, in front of all others
  const int width = job.width / job.samples, height = job.height / job.samples;
  const Memory areas((size_t)areas_bytes(width, height, job.views), 0x7f);
  int error = 0;
  if (p->packed) {
    error |= BIGTRI_RUNG::begin_shading_cuda(job, scratch.of<char>(), nullptr);
  } else {
    Frame f = {};
    f.positions = job.positions;
    f.triangles = job.triangles;
    f.vertices = job.vertices;
    f.view_stride = job.vertices * 4;
    f.count = job.count;
    f.views = (int32_t)job.views;
    f.view = {job.width, job.height, 0, 0, job.width, job.height, (int)p->cull};
    f.packed = p->drawn ? (int64_t*)output(p->drawn, 8 * samples) : buffer.of<int64_t>();
    f.depth = (float*)output(p->depth, 4 * samples);
    f.dropped = (int64_t*)output(p->dropped, 8 * job.views);
    const CudaVariant& variant = **BIGTRI_NAMESPACE::kCudaVariants;
    std::vector<int64_t> values;
    for (const Parameter* parameter = variant.parameters; parameter->name; ++parameter)
      values.push_back(parameter->standard);
    if (!p->drawn && !p->depth && variant.lists_areas && variant.lists_areas(f, values.data()) &&
        BIGTRI_RUNG::shades_areas(job)) {
      f.areas = job.areas = areas.of<char>();
      f.area_samples = job.samples;
    }
    const Memory work(variant.scratch_bytes(f, values.data()), 0x7f);
    error |= BIGTRI_RUNG::begin_shading_cuda(job, scratch.of<char>(), nullptr);
    error |= variant.draw(f, values.data(), work.of<char>(), nullptr);
    job.packed = f.packed;
  }
  error |= BIGTRI_RUNG::shade_cuda(job, scratch.of<char>(), nullptr);
  for (const Output& o : outputs) memcpy(o.to, o.from, (size_t)o.bytes);
  return error;
}
}
