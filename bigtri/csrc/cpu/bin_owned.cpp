// The bin-owned variant, arranged from the per-ISA kernels: project every vertex once, then batch by batch set up, bin and draw (bin_owned.inl). Batches bound the memory;
// nothing is ever left out.

#include "rasterize.h"

#include <algorithm>
#include <atomic>
#include <climits>
#include <memory>
#include <numeric>
#include <vector>

namespace bigtri {
namespace {

constexpr int64_t kMaxChunk = 4096;  // triangles; even if all are clipped to the most sub-triangles, one chunk fits a batch
static_assert(kMaxChunk * kMaxSubTriangles <= BatchLimits{}.records, "a chunk fits a batch");

std::atomic<int64_t> max_records{BatchLimits{}.records}, max_candidates{BatchLimits{}.candidates};

template <class T>
std::unique_ptr<T[]> allocate(int64_t n) {  // not initialised
  return std::unique_ptr<T[]>(new T[(size_t)std::max<int64_t>(n, 1)]);
}

// A run of triangles and the slots reserved for their records.
struct Chunk {
  int64_t begin, end;  // triangles
  int64_t slot, slots, used;  // records
  int64_t dropped;
};

int64_t slots_needed(const SetupJob& job, int64_t begin, int64_t end) {
  int64_t n = 0;
  for (int64_t t = begin; t < end; ++t) {
    uint32_t flags = 0;
    for (int k = 0; k < 3; ++k) flags |= job.vertices[job.triangles[3 * t + k] - job.first_vertex].flags;
    n += flags & kOutsideMask ? kMaxSubTriangles : 1;
  }
  return n;
}

class Frame {
 public:
  Frame(const Kernels& kernels, const Parallel& parallel, const Viewport& view, int64_t* packed, float* depth)
      : kernels_(kernels), parallel_(parallel), scratch_(allocate_scratch(parallel.threads)) {
    job_ = {};
    job_.view = view;
    job_.packed = packed;
    job_.depth = depth;
    job_.bins_x = bin_columns(view);
    job_.bins_y = bin_rows(view);
    job_.first_pass = true;
  }

  // Draws the records of the slots [0, count) that have candidates, in as many passes as their bins need.
  void draw(const Record* records, const uint32_t* candidates, int64_t count) {
    job_.records = records;
    const int64_t limit = max_candidates.load(std::memory_order_relaxed);
    for (int64_t begin = 0; begin < count;) {
      int64_t end = begin, total = 0;
      while (end < count && (total == 0 || total + candidates[end] <= limit)) total += candidates[end++];
      if (total) pass(candidates, begin, end, total);
      begin = end;
    }
  }

  // A frame that no triangle has touched still has to be written.
  void finish() {
    if (!job_.first_pass) return;
    std::vector<uint32_t> none(bins() + 1, 0);
    raster(nullptr, none.data());
  }

 private:
  static std::unique_ptr<char[]> allocate_scratch(int threads) { return allocate<char>(threads * kScratchBytes + 64); }
  int64_t bins() const { return (int64_t)job_.bins_x * job_.bins_y; }

  // A counting sort of (record, bin) pairs by bin: count per chunk, place, scatter. Chunks keep the order of the records, so lists do not depend on the threads.
  void pass(const uint32_t* candidates, int64_t begin, int64_t end, int64_t total) {
    const int64_t wanted = std::min<int64_t>(parallel_.threads > 1 ? 4 * parallel_.threads : 1, total / 2048 + 1);
    std::vector<int64_t> bounds = {begin}, pair_begin = {0};
    int64_t sum = 0;
    for (int64_t i = begin; i < end; ++i) {
      sum += candidates[i];
      if (sum >= (int64_t)bounds.size() * total / wanted && i + 1 < end && (int64_t)bounds.size() < wanted) {
        bounds.push_back(i + 1);
        pair_begin.push_back(sum);
      }
    }
    const int64_t chunks = (int64_t)bounds.size();
    bounds.push_back(end);
    const auto pairs = allocate<BinPair>(total);
    std::vector<uint32_t> counts(chunks * bins(), 0);
    std::vector<int64_t> used(chunks);
    parallel_(chunks, [&](int64_t c) {
      used[c] = kernels_.bin(job_.records, candidates, bounds[c], bounds[c + 1], job_.bins_x, pairs.get() + pair_begin[c], counts.data() + c * bins());
    });
    std::vector<uint32_t> list_begin(bins() + 1);
    uint32_t at = 0;
    for (int64_t b = 0; b < bins(); ++b) {
      list_begin[b] = at;
      for (int64_t c = 0; c < chunks; ++c) {
        const uint32_t n = counts[c * bins() + b];
        counts[c * bins() + b] = at;
        at += n;
      }
    }
    list_begin[bins()] = at;
    const auto entries = allocate<uint32_t>(at);
    parallel_(chunks, [&](int64_t c) {
      uint32_t* next = counts.data() + c * bins();
      for (const BinPair *p = pairs.get() + pair_begin[c], *stop = p + used[c]; p < stop; ++p) entries[next[p->bin]++] = p->entry;
    });
    raster(entries.get(), list_begin.data());
  }

  void raster(const uint32_t* entries, const uint32_t* list_begin) {
    job_.entries = entries;
    job_.list_begin = list_begin;
    // First come, first served: a worker that had a crowded bin takes fewer of them.
    std::atomic<int64_t> next{0};
    const int64_t n = bins(), workers = std::min<int64_t>(parallel_.threads, n);
    parallel_(workers, [&](int64_t worker) {
      char* scratch = scratch_.get() + worker * kScratchBytes;
      scratch += -(uintptr_t)scratch & 63;
      for (int64_t b; (b = next.fetch_add(1, std::memory_order_relaxed)) < n;) kernels_.raster_bin(job_, (int)b, scratch);
    });
    job_.first_pass = false;
  }

  const Kernels& kernels_;
  const Parallel& parallel_;
  RasterJob job_;
  std::unique_ptr<char[]> scratch_;
};

}  // namespace

BatchLimits batch_limits() { return {max_records.load(std::memory_order_relaxed), max_candidates.load(std::memory_order_relaxed)}; }

void set_batch_limits(const BatchLimits& limits) {
  max_records.store(limits.records, std::memory_order_relaxed);
  max_candidates.store(limits.candidates, std::memory_order_relaxed);
}

int64_t draw_bin_owned(const Kernels& kernels, const Parallel& parallel, const Mesh& mesh, const Viewport& view, int64_t* packed, float* depth) {
  Frame frame(kernels, parallel, view, packed, depth);
  if (mesh.count == 0) {
    frame.finish();
    return 0;
  }
  const int64_t vertex_count = mesh.highest - mesh.lowest + 1;
  const auto vertices = allocate<Vertex>(vertex_count);
  const int64_t vertex_chunks = std::min<int64_t>(4 * parallel.threads, vertex_count / 4096 + 1);
  parallel(vertex_chunks, [&](int64_t c) {
    const int64_t begin = vertex_count * c / vertex_chunks, end = vertex_count * (c + 1) / vertex_chunks;
    kernels.project(mesh.positions, mesh.lowest + begin, mesh.lowest + end, view.width, view.height, vertices.get() + begin);
  });

  const SetupJob job = {mesh.positions, mesh.triangles, vertices.get(), mesh.lowest, view};
  const int64_t limit = max_records.load(std::memory_order_relaxed);
  const int64_t chunk_size = std::min(limit, std::clamp<int64_t>(mesh.count / (8 * parallel.threads), 64, kMaxChunk));
  const int64_t chunk_count = (mesh.count + chunk_size - 1) / chunk_size;
  std::vector<Chunk> chunks(chunk_count);
  parallel(chunk_count, [&](int64_t c) {
    Chunk& k = chunks[c];
    k = {c * chunk_size, std::min(mesh.count, (c + 1) * chunk_size), 0, 0, 0, 0};
    k.slots = slots_needed(job, k.begin, k.end);
  });

  for (int64_t first = 0; first < chunk_count;) {
    int64_t last = first, slots = 0;
    while (last < chunk_count && (last == first || slots + chunks[last].slots <= limit)) {
      chunks[last].slot = slots;
      slots += chunks[last++].slots;
    }
    const auto records = allocate<Record>(slots);
    const auto candidates = allocate<uint32_t>(slots);
    parallel(last - first, [&](int64_t i) {
      Chunk& k = chunks[first + i];
      k.used = kernels.setup(job, k.begin, k.end, records.get() + k.slot, candidates.get() + k.slot, &k.dropped);
      std::fill(candidates.get() + k.slot + k.used, candidates.get() + k.slot + k.slots, 0u);
    });
    frame.draw(records.get(), candidates.get(), slots);
    first = last;
  }
  frame.finish();
  return std::accumulate(chunks.begin(), chunks.end(), (int64_t)0, [](int64_t sum, const Chunk& c) { return sum + c.dropped; });
}

}  // namespace bigtri
