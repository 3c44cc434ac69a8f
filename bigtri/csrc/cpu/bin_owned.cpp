// The bin_owned variant: calls the kernels of bin_owned.h over threads, from clip-space vertices to the image.
// The binding calls draw() through the registry (variants.cpp). It writes packed, depth and dropped of every view.
//
// Views are drawn in groups; a group's vertices are projected once. Its triangles are cut into chunks, and chunks form
// batches: the records of a batch are held at once. A pass sorts records of a batch into bin lists and draws the bins.
// Groups, batches and passes bound the memory; no triangle is left out. Bins are numbered through all views, so that
// many small views keep the threads as busy as one large view does. Where views are many and small, each thread draws
// some of them by itself, as one drawing after the other.

#include <algorithm>
#include <atomic>
#include <climits>
#include <memory>
#include <numeric>
#include <vector>

#include "counting.h"
#include "groups.h"
#include "pages.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

// Most triangles of a chunk. A chunk fits a standard batch even if each of its triangles is clipped to
// kMaxSubTriangles.
constexpr int64_t kMaxChunk = 4096;
constexpr int64_t kStandardRecords = 1 << 18, kStandardCandidates = 1 << 23;
static_assert(kMaxChunk * kMaxSubTriangles <= kStandardRecords, "a chunk fits a batch");

// Bounds on memory: records of a batch, candidates of a pass. More of them take more batches and passes. A batch takes
// one chunk at least, and a pass takes one record at least, so small bounds cannot stop a drawing.
constexpr Parameter kParameters[] = {
    // An entry has 30 bits for its record's slot (kEntryShift).
    {"records", "slots",
     "slots for (sub)triangles set up at once, 100 bytes each; a triangle that is clipped reserves 26",
     kStandardRecords, 1, int64_t{1} << 30},
    // list_begin is uint32.
    {"candidates", "bins", "bins that the records of a pass touch by their bounding boxes, 12 bytes each",
     kStandardCandidates, 1, UINT32_MAX},
    {},
};
enum { kRecords, kCandidates };

// A batch of several views has a view for each thread, and more of them up to this many slots per thread: 1.5 MB of
// records, which the cache of one core holds. With larger batches, setting up and drawing many small views takes 10 %
// longer.
constexpr int64_t kRecordsToJoin = 1 << 14;
// Views are drawn by one thread each if there are this many per thread.
constexpr int64_t kViewsPerThread = 8;
// Pixels of all views. A visibility buffer of more, 4 MiB, is streamed. At 640x480 px ordinary stores take 0.06 ms less;
// at 1920x1080 px they save 0.2 ms while the last-level cache is free, and cost 0.5 ms where neighbours use it.
constexpr int64_t kPackedInCache = 1 << 19;
// The same for a depth image of 16 MiB. At 1920x1080 px ordinary stores take 0.15 ms less,
// since the image stays in the last-level cache; at 3840x2160 px streaming takes 2 ms less.
constexpr int64_t kDepthInCache = 1 << 22;
// Pixels of all views whose background is not streamed where it fills whole rows, 16 MiB of packed: half of a last-level
// cache, in which they stay from one image to the next. 1920x1080 px of background take 0.1 to 0.2 ms instead of 0.6; of
// 3840x2160 px a quarter is stored so, and all take a seventh less on two threads, but no less on one.
constexpr int64_t kRowsInCache = 1 << 21;
// Bins without entries that are stored together, row by row: 4 KiB of packed in a row, which is a page of memory. One
// by one they would visit each page eight times.
constexpr int64_t kMostEmpty = 8;
// A row of bins that has no entries at all is stored as one piece if there are this many rows of bins per thread, so
// that the last piece leaves no thread idle for long.
constexpr int64_t kRowsPerThread = 4;
// Histogram entries of the counting sort, 4 bytes each. A pass has one per bin and run of records.
constexpr int64_t kMostCounts = 1 << 23;

// A run of triangles of one view, and the slots of the batch that are reserved for its records.
struct Chunk {
  int64_t view;               // within the group
  int64_t begin, end;         // triangles, half-open
  int64_t slot, slots, used;  // first slot, slots reserved, slots that got a record
  int64_t candidates;         // of all its records
  int64_t dropped;            // triangles
};

// Records that are held at once, by slot. A slot without candidates has no record.
struct Batch {
  const Record* records;
  const uint32_t* candidates;  // of each slot
  const Chunk *begin, *end;

  // Takes slots from `first` to at most `last`, as long as they have no more than `most` candidates together, but at
  // least one that has any. Returns where it stopped. A chunk that fits is taken as a whole: where most triangles cover
  // nothing, nearly all slots are empty, and one thread goes through them while the others wait.
  int64_t take(int64_t first, int64_t last, int64_t most, int64_t* total) const {
    const Chunk* k =
        std::upper_bound(begin, end, first, [](int64_t slot, const Chunk& c) { return slot < c.slot; }) - 1;
    int64_t at = first, sum = 0;
    for (; at < last; ++k) {
      const int64_t stop = k->slot + k->slots, used = std::min(k->slot + k->used, last);
      if (at == k->slot && stop <= last && sum + k->candidates <= most) {
        sum += k->candidates;
      } else {
        for (; at < used && (sum == 0 || sum + candidates[at] <= most); ++at) sum += candidates[at];
        if (at < used) break;
      }
      at = std::min(stop, last);
    }
    *total = sum;
    return at;
  }
};

// Upper bound on the records of triangles [begin, end): none of a triangle beyond the screen or behind the camera, which in a
// room half of them are; kMaxSubTriangles of one that is clipped.
int64_t slots_needed(const SetupJob& job, int64_t begin, int64_t end) {
  int64_t n = 0;
  for (int64_t t = begin; t < end; ++t) {
    const int32_t* index = job.frame.triangles + 3 * t;
    const Fate fate =
        fate_of(vertex_of(job, index[0]).flags, vertex_of(job, index[1]).flags, vertex_of(job, index[2]).flags);
    n += fate == Fate::kClip ? kMaxSubTriangles : fate == Fate::kWhole;
  }
  return n;
}

// A worker's memory: for a bin, and for shading it.
int64_t scratch_bytes(const CheckedFrame& frame) { return kScratchBytes + (frame.shade ? kShadeScratchBytes : 0); }

// Which pixels are stored around the caches: what RasterJob says of it.
struct Stores {
  bool streams_packed, streams_depth;
  int64_t rows_in_cache;
};

Stores stores_of(const CheckedFrame& frame, int threads) {
  const int64_t pixels = pixels_of_all(frame);
  return {pixels > kPackedInCache, pixels > kDepthInCache, pixels <= kRowsInCache || threads > 1 ? kRowsInCache : 0};
}

class Drawing {
 public:
  Drawing(const CheckedFrame& frame, const Parallel& parallel, int64_t most_records, int64_t most_candidates,
          const Stores& stores)
      : frame_(frame),
        kernels_(current_kernels().bin_owned),
        parallel_(parallel),
        most_records_(most_records),
        most_candidates_(most_candidates),
        scratch_((*workspace_).workers.room<char>(parallel.threads * scratch_bytes(frame))),
        shade_begun_(parallel.threads, 0) {
    job_ = {};
    job_.shade = frame.shade;
    job_.view = frame.view;
    job_.packed = frame.packed;
    job_.depth = frame.depth;
    job_.counters = frame.counters;
    job_.map = frame.map;
    job_.streams_packed = stores.streams_packed;
    job_.streams_depth = stores.streams_depth;
    job_.rows_in_cache = stores.rows_in_cache;
    job_.bins_x = bin_columns(frame.view);
    job_.bins = job_.bins_x * bin_rows(frame.view);
  }

  void draw() {
    std::fill(frame_.dropped, frame_.dropped + frame_.views, 0);
    each_group(frame_, parallel_, &(*workspace_).vertices,
               [&](int64_t first, const ProjectedFrame& group) { draw_group(first, group); });
    finish_open_view();
    job_.finished_views = frame_.views;
    raster(frame_.views, nullptr, nullptr);  // background of the views that no pass has begun
    counts_.publish(frame_.counters);
  }

 private:
  // Draws a group of views, of which view `first` is the first.
  void draw_group(int64_t first, const ProjectedFrame& group) {
    const auto job_of = [&](int64_t view) { return setup_job(group, view); };
    // Some 8 chunks per thread, of 64 to kMaxChunk triangles, at most as many as a batch has slots. A view without
    // triangles has none.
    const int64_t triangles = triangles_of_all(group);
    const int64_t size =
        std::min(most_records_,
                 std::clamp<int64_t>(std::min(triangles, most_records_) / (8 * parallel_.threads), 64, kMaxChunk));
    std::vector<Chunk> chunks;
    for (int64_t view = 0; view < group.views; ++view) {
      const Range range = range_of(group, view);
      for (int64_t begin = range.first; begin < range.end; begin += size)
        chunks.push_back({view, begin, std::min(range.end, begin + size), 0, 0, 0, 0, 0});
    }
    for (Chunk& k : chunks) k.slots = k.end - k.begin;
    if (group.any_clipped)
      parallel_((int64_t)chunks.size(), [&](int64_t c) {
        chunks[c].slots = slots_needed(job_of(chunks[c].view), chunks[c].begin, chunks[c].end);
      });

    std::vector<int64_t> view_slots(group.views, 0);
    for (const Chunk& k : chunks) view_slots[k.view] += k.slots;

    // One batch: the chunks [begin, end). Another view joins it only as a whole, so that no bin is drawn with a part of its
    // triangles; a view with more slots than a batch may have takes several.
    for (size_t begin = 0; begin < chunks.size();) {
      size_t end = begin;
      int64_t slots = 0;
      const auto joins = [&](const Chunk& next) {
        if (next.view == chunks[end - 1].view) return slots + next.slots <= most_records_;
        const int64_t together = slots + view_slots[next.view], joined = next.view - chunks[begin].view;
        return together <= most_records_ &&
               (joined < parallel_.threads || together <= kRecordsToJoin * parallel_.threads);
      };
      while (end < chunks.size() && (end == begin || joins(chunks[end]))) {
        chunks[end].slot = slots;
        slots += chunks[end++].slots;
      }
      Record* const records = (*workspace_).records.room<Record>(slots);
      uint32_t* const candidates = (*workspace_).candidates.room<uint32_t>(slots);
      parallel_((int64_t)(end - begin), [&](int64_t i) {
        Chunk& k = chunks[begin + i];
        k.used = current_kernels().setup.setup(job_of(k.view), k.begin, k.end, records + k.slot, candidates + k.slot,
                                               &k.dropped);
        uint32_t* const first = candidates + k.slot;
        k.candidates = std::accumulate(first, first + k.used, int64_t{0});
        std::fill(first + k.used, first + k.slots, 0u);
      });
      // First slot of each view of the batch; the last element ends the last view.
      std::vector<int64_t> view_begin;
      const int64_t first_view = first + chunks[begin].view;
      for (size_t i = begin; i < end; ++i) {
        while (first_view + (int64_t)view_begin.size() <= first + chunks[i].view) view_begin.push_back(chunks[i].slot);
        frame_.dropped[first + chunks[i].view] += chunks[i].dropped;
        counts_.add(Counter::records, chunks[i].used);
        counts_.add(Counter::bytes, chunks[i].used * (int64_t)sizeof(Record));
      }
      view_begin.push_back(slots);
      const Batch batch = {records, candidates, chunks.data() + begin, chunks.data() + end};
      draw_records(batch, first_view, view_begin, end == chunks.size() || chunks[end].view != chunks[end - 1].view);
      begin = end;
    }
  }

  // Draws a batch, in as many passes as most_candidates_ asks for. The records of view first_view + v are in the slots
  // [view_begin[v], view_begin[v + 1]).
  // Whether the batch ends its last view is ends_last; it ends every other.
  void draw_records(const Batch& batch, int64_t first_view, const std::vector<int64_t>& view_begin, bool ends_last) {
    const int64_t count = view_begin.back();
    job_.records = batch.records;
    size_t view = 0;
    for (int64_t begin = 0; begin < count;) {
      int64_t total;
      const int64_t end = batch.take(begin, count, most_candidates_, &total);
      while (begin >= view_begin[view + 1]) ++view;
      size_t last = view;
      while (end > view_begin[last + 1]) ++last;
      if (total)
        pass(batch, begin, end, total, first_view + (int64_t)view, (int64_t)(last - view) + 1, view_begin.data() + view,
             end == view_begin[last + 1] && (end < count || ends_last));
      begin = end;
    }
  }

  // Sorts the records in slots [begin, end) into bin lists and draws the bins of their views. total: their candidates.
  // The sort is a counting sort of (bin, entry) pairs. The slots are cut into runs of about equal candidates.
  // Count: each run writes its pairs and counts them per bin. Place: running sums turn the counts into
  // places in `entries`. Scatter: each run copies its entries there. Places follow the order of the runs, so the
  // lists do not depend on the threads. ends_last: no later pass has records of the last view.
  void pass(const Batch& batch, int64_t begin, int64_t end, int64_t total, int64_t first_view, int64_t views,
            const int64_t* view_begin, bool ends_last) {
    if (open_view_ < first_view) finish_open_view();
    const int64_t bins = views * job_.bins;
    const int64_t wanted = std::min({(int64_t)(parallel_.threads > 1 ? 4 * parallel_.threads : 1), total / 2048 + 1,
                                     std::max<int64_t>(1, kMostCounts / bins)});
    std::vector<int64_t> bounds = {begin}, pair_begin = {0};
    for (int64_t at = begin, sum = 0; (int64_t)bounds.size() < wanted;) {
      int64_t of_run;
      at = batch.take(at, end, (int64_t)bounds.size() * total / wanted - sum, &of_run);
      if (at == end) break;
      bounds.push_back(at);
      pair_begin.push_back(sum += of_run);
    }
    const int64_t runs = (int64_t)bounds.size();
    bounds.push_back(end);
    const BinJob job = {batch.records, batch.candidates, view_begin, job_.bins_x, job_.bins};
    BinPair* const pairs = (*workspace_).pairs.room<BinPair>(total);
    uint32_t* const counts = (*workspace_).counts.room<uint32_t>(runs * bins);
    std::fill(counts, counts + runs * bins, 0u);
    std::vector<int64_t> used(runs);
    parallel_(runs, [&](int64_t c) {
      Counts work(frame_.map);
      used[c] = kernels_.bin(job, bounds[c], bounds[c + 1], pairs + pair_begin[c], counts + c * bins, &work);
      work.publish(frame_.counters);
    });
    // Bins of views that no pass has begun and that come before this pass. Their lists are empty; they are drawn with
    // this pass, as background.
    const int64_t ahead = std::max<int64_t>(0, first_view - job_.begun_views) * job_.bins;
    std::vector<uint32_t> list_begin(ahead + bins + 1);
    uint32_t at = 0;
    for (int64_t b = 0; b < bins; ++b) {
      list_begin[ahead + b] = at;
      for (int64_t c = 0; c < runs; ++c) {
        const uint32_t n = counts[c * bins + b];
        counts[c * bins + b] = at;
        at += n;
      }
    }
    list_begin[ahead + bins] = at;
    counts_.add(Counter::candidates, total);
    counts_.add(Counter::entries, at);
    counts_.add(Counter::bytes, at * (int64_t)(sizeof(BinPair) + sizeof(uint32_t)));
    uint32_t* const entries = (*workspace_).entries.room<uint32_t>(at);
    parallel_(runs, [&](int64_t c) {
      uint32_t* next = counts + c * bins;
      for (const BinPair *p = pairs + pair_begin[c], *stop = p + used[c]; p < stop; ++p)
        entries[next[p->bin]++] = p->entry;
    });
    job_.first_bin = first_view * job_.bins - ahead;
    job_.finished_views = first_view + views - !ends_last;
    raster(first_view + views, entries, list_begin.data());
  }

  // Finds memory for the pixels of the open view, apart from that of the view that the pass begins with.
  void hold_open_view() {
    if (job_.begun.view == open_view_) {
      job_.unfinished = job_.begun;
      return;
    }
    auto& memory = held_[job_.begun.pixels && job_.begun.pixels == held_[0].get()];
    if (!memory) memory.reset(new int64_t[(size_t)job_.view.width * job_.view.height]);  // uninitialised
    job_.unfinished.view = open_view_;
    job_.unfinished.pixels = memory.get();
  }

  // Shades the open view, of which no later pass has a record that reaches a bin.
  void finish_open_view() {
    if (open_view_ < 0) return;
    ShadeJob one = views_of(*job_.shade, open_view_, 1);
    one.packed = job_.packed ? pixels_of(frame_, open_view_) : job_.unfinished.pixels;
    shade_views(one, parallel_);
    open_view_ = -1;
    job_.unfinished = {};
  }

  // Draws the bins from job_.first_bin on, up to view end_view. If list_begin is null, it writes background to all
  // views below end_view that no pass has begun.
  void raster(int64_t end_view, const uint32_t* entries, const uint32_t* list_begin) {
    std::vector<uint32_t> none;
    if (!list_begin) {
      job_.first_bin = job_.begun_views * job_.bins;
      none.assign(end_view * job_.bins - job_.first_bin + 1, 0);
      list_begin = none.data();
    }
    job_.entries = entries;
    job_.list_begin = list_begin;
    // What a worker takes at a time: a bin, or a run of bins of a row that have no entries. runs[i] is the first bin of
    // run i; the last element ends the last run.
    const int64_t end = end_view * job_.bins, bins_x = job_.bins_x;
    std::vector<int64_t> runs;
    const auto empty = [&](int64_t b, int64_t n) {
      return list_begin[b - job_.first_bin] == list_begin[b - job_.first_bin + n];
    };
    const bool whole_rows = end - job_.first_bin >= kRowsPerThread * parallel_.threads * bins_x;
    for (int64_t row = job_.first_bin; row < end; row += bins_x) {
      runs.push_back(row);
      if (whole_rows && empty(row, bins_x)) continue;
      for (int64_t b = row + 1; b < row + bins_x; ++b)
        if (b - runs.back() == kMostEmpty || !empty(b, 1) || !empty(b - 1, 1)) runs.push_back(b);
    }
    runs.push_back(end);
    job_.begun = job_.unfinished;
    job_.unfinished = {};
    open_view_ = job_.shade && job_.finished_views < end_view ? end_view - 1 : -1;
    if (open_view_ >= 0 && !job_.packed) hold_open_view();
    // Runs that follow each other lie in different parts of the image, one for each thread: threads that write side by side
    // take up to an eighth longer at 4K (docs/performance.md).
    const int64_t count = (int64_t)runs.size() - 1, parts = parallel_.threads;
    parallel_.with_slots(parts * ((count + parts - 1) / parts), [&](int64_t i, int64_t slot) {
      const int64_t part = i % parts, run = count * part / parts + i / parts;
      if (run >= count * (part + 1) / parts) return;
      char* scratch = scratch_ + slot * scratch_bytes(frame_);
      char* shade_scratch = scratch + kScratchBytes;
      if (job_.shade && !shade_begun_[slot]) job_.shade->kernels->begin(*job_.shade, shade_scratch);
      shade_begun_[slot] = 1;
      kernels_.raster_bins(job_, runs[run], (int)(runs[run + 1] - runs[run]), scratch, shade_scratch);
    });
    job_.begun_views = std::max(job_.begun_views, end_view);
  }

  const CheckedFrame& frame_;
  const BinOwnedKernels& kernels_;
  const Parallel& parallel_;
  const int64_t most_records_, most_candidates_;  // of a batch; of a pass
  const KeptWorkspace workspace_;
  RasterJob job_;                                 // of the pass that is drawn
  char* const scratch_;                           // scratch_bytes per worker
  std::vector<char> shade_begun_;                 // of each worker: whether its memory for shading is in use
  int64_t open_view_ = -1;  // the view of the last pass that was not finished, if a picture is made; else -1
  std::unique_ptr<int64_t[]> held_[2];  // for job_.begun and job_.unfinished
  Counts counts_;
};

// A part of all views for one thread: how many views it draws at a time, 0 where all threads draw the same views
// together, and the most records that it sets up at once.
struct Share {
  int64_t views, most_records;
};

// By itself a thread waits for nobody, and what set-up has written is in its own cache. That needs many views for each
// thread, since the last one's work is what the others wait for, and small ones: the records of a view fit a batch, those
// of all threads together are no more than a batch or kRecordsToJoin each, and all vertices no more than a group.
Share share_of(const CheckedFrame& frame, int threads, int64_t most_records) {
  const int64_t used = used_vertices(frame);
  const int64_t most = std::max(most_records / threads, std::min(most_records, kRecordsToJoin));
  if (threads == 1 || frame.views < kViewsPerThread * threads || !frame.view_stride || !used) return {0, 0};
  if (frame.count > most || used > kGroupVertices / threads) return {0, 0};
  return {std::clamp<int64_t>(kRecordsToJoin / frame.count, 1, frame.views / (kViewsPerThread * threads)), most};
}

void draw(const CheckedFrame& frame, const Parallel& parallel, const int64_t* values) {
  const int threads = parallel.threads;
  touch_if_new(frame.packed, pixels_of_all(frame), parallel);
  touch_if_new(frame.depth, pixels_of_all(frame), parallel);
  const int64_t most_records = values[kRecords], most_candidates = values[kCandidates];
  const Stores stores = stores_of(frame, threads);
  const Share share = share_of(frame, threads, most_records);
  if (!share.views) {
    Drawing(frame, parallel, most_records, most_candidates, stores).draw();
    return;
  }
  parallel((frame.views + share.views - 1) / share.views, [&](int64_t i) {
    const int64_t first = i * share.views, count = std::min(share.views, frame.views - first);
    CheckedFrame part = frame;
    static_cast<Frame&>(part) = views_of(frame, first, (int32_t)count);
    ShadeJob picture;
    if (frame.shade) {
      picture = views_of(*frame.shade, first, count);
      part.shade = &picture;
    }
    Stores here = stores;
    here.rows_in_cache -= first * frame.view.width * frame.view.height;
    const int64_t candidates = std::max<int64_t>(most_candidates / threads, 1);
    Drawing(part, Parallel{1}, share.most_records, candidates, here).draw();
  });
}

}  // namespace

extern const Variant bin_owned_variant;
const Variant bin_owned_variant = {"bin_owned", "one owner a bin, hidden surfaces rejected; docs/performance.md",
                                   kParameters, draw, /*shades=*/true};

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri
