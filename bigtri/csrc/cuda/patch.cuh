// A block owns patches of bins, 64 px wide, and each of its warps a region of each: four side by side. Candidates are
// looked at once for a whole patch, a thread each, and for as many patches at once as there are threads. Hidden
// surfaces are rejected without sorting, per patch and per region: whatever covers an area completely bounds the depth
// behind which nothing can be seen.
#pragma once

#include "patch_rows.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

// The bins that a record or primitive touches, first and last column and row, a byte each: what a block looks at before
// the record itself.
template <class Boxed>
__device__ __forceinline__ uint32_t box_of(const Boxed& r) {
  return (uint32_t)(r.x0 / kBin) | (uint32_t)(r.y0 / kBin) << 8 | (uint32_t)((r.x1 - 1) / kBin) << 16 |
         (uint32_t)((r.y1 - 1) / kBin) << 24;
}
constexpr uint32_t kNoBox = 0x000000ff;  // first column after the last: in no bin
// The same of one of several views.
struct ViewBox {
  uint32_t box;
  int32_t view;
};
__device__ __forceinline__ bool in_box(uint32_t box, int, int bin_x, int bin_y) {
  return bin_x >= (int)(box & 0xff) && bin_y >= (int)(box >> 8 & 0xff) && bin_x <= (int)(box >> 16 & 0xff) &&
         bin_y <= (int)(box >> 24);
}
__device__ __forceinline__ bool in_box(const ViewBox& box, int view, int bin_x, int bin_y) {
  return box.view == view && in_box(box.box, view, bin_x, bin_y);
}

// Records one after the other, of a frame with one view.
struct Candidates {
  static constexpr bool kLists = false;
  const Record* records;
  const uint32_t* boxes;

  __device__ __forceinline__ int slot(int i) const { return i; }
  __device__ __forceinline__ uint32_t box(int i) const { return boxes[i]; }
};

// Blocks that own pixels draw so many records together for each of their warps. With 19 records a warp where a block
// sets up all triangles itself (FewShared in bin_owned.cu), that is as many as fit 64 KiB of shared memory, which a
// block can have on all devices.
constexpr int kEntriesOfWarp = 22;
constexpr int kMostWarps = 16;  // of such a block
constexpr int kMostEntries = kEntriesOfWarp * kMostWarps;

constexpr int kTurn = 8;  // patches that a block takes at a time

// A patch's entries are drawn by rows if there are more than kFewEntries, whose boxes have fewer pixels in it on average than
// kSmallEntry, and than kSmallEntryRow for each of its rows. Larger ones cost less by regions, and hide others there.
constexpr int kFewEntries = 4, kSmallEntry = 192, kSmallEntryRow = 12;  // px

// The regions of a block's warps in a bin, and what is known of them; 16 bytes, to be read at once. kBlockTeams: the warps are
// so many teams, of which each draws patches of its own where these are drawn by regions.
template <int kBlockWarps, int kLaneRows, int kBlockTeams = 1>
struct alignas(16) Patch {
  using Region = RegionOf<kLaneRows>;
  static constexpr int kWarps = kBlockWarps, kThreads = kWarps * kWarp, kMaxEntries = kEntriesOfWarp * kWarps;
  static constexpr int kTeams = kBlockTeams, kRegions = kWarps / kTeams;  // warps of a team
  static_assert(kWarps % kTeams == 0 && kRegions % 4 == 0, "a team has whole rows of regions");
  static constexpr int kRows = kRegions / 4 * Region::kHeight;  // px
  static_assert(kBin % kRows == 0, "a patch lies in one bin");
  static constexpr int kNowhere = kBin << 16;  // with no pixel, and in no box
  int left, top;  // px; left: kNowhere behind the last patch
  uint32_t bound;  // bits of the depth behind which nothing of it can be seen
  int waiting;  // entries in its list, and above kCountBits the pixels of their boxes in it

  static constexpr int kCountBits = 10;
  static_assert(kMaxEntries < 1 << kCountBits && (int64_t)kMaxEntries * kRows * kBin < 1 << (31 - kCountBits),
                "both fit");
  static __device__ int entries_in(int waiting) { return waiting & ((1 << kCountBits) - 1); }
  __device__ int entries() const { return entries_in(waiting); }
  __device__ bool by_rows() const {
    constexpr int kSmall = kRows * kSmallEntryRow < kSmallEntry ? kRows * kSmallEntryRow : kSmallEntry;
    return entries() > kFewEntries && waiting >> kCountBits < kSmall * entries();
  }
  // What an entry of the record adds to `waiting`.
  __device__ int added_by(const Record& r) const {
    const int columns = min_of(r.x1, left + kBin) - max_of(r.x0, left),
              rows = min_of(r.y1, top + kRows) - max_of(r.y0, top);
    return 1 + (max_of(columns, 0) * max_of(rows, 0) << kCountBits);
  }
  __device__ int bin_x() const { return left >> kBinBits; }
  __device__ int bin_y() const { return top >> kBinBits; }

  __host__ __device__ static int count(const Viewport& v) { return bin_columns(v) * ((v.height + kRows - 1) / kRows); }
  __device__ static Patch at(const Viewport& v, int i) {
    const int row = i / bin_columns(v);
    return {row * kRows < v.height ? (i - row * bin_columns(v)) * kBin : kNowhere, row * kRows, float_bits(kInfinity),
            0};
  }
};

// threadIdx.x, read anew.
__device__ __forceinline__ uint32_t this_thread() {
  uint32_t i;
  asm volatile("mov.u32 %0, %%tid.x;" : "=r"(i));
  return i;
}

// Shared memory of a block that owns patches P. What all of its threads know is here too, and read again where it is
// needed: the registers are for drawing, and what spills out of them comes back from far away.
template <class P>
struct PatchShared {
  static constexpr int kThreads = P::kThreads;
  PatchEntry entries[P::kMaxEntries];  // of records in the bin that a patch lies in
  uint16_t list[kThreads];  // those that can be seen: a part for each patch
  union {
    // The threads' next candidates, while those gathered are drawn because there is no room for more; from the last
    // thread to the first, since else the compiler keeps an address.
    int32_t cursor[kThreads];
    uint32_t spans[kThreads];  // of each warp that draws by rows, where there was room for all
  };
  P patch[kTurn];
  int view[kTurn];  // of each patch
  int entry_count;  // asked for
  int count;  // candidates that all patches look at
  int listed[kTurn];  // candidates of each patch besides, in its bin's list
  // 2^together_bits patches are looked at together: as many as there are threads to look at the candidates of
  // each.
  int together_bits;
  int next_turn;  // number of its first patch
  bool last_turn;  // there is no next one
  int patches;  // of this turn
  unsigned touched;  // bits of the patches that have a candidate, where these are many
  bool drawn;  // the frame holds what has been drawn before
  bool resumed;  // the patches have been drawn once

  // By one thread; a barrier has to follow.
  __device__ __forceinline__ void begin(int candidates, bool on_what_is_there) {
    count = candidates;
    drawn = on_what_is_there;
    look_at(candidates);
  }
  // The most candidates that a patch has.
  __device__ __forceinline__ void look_at(int most) {
    const int bits = 31 - __clz(kThreads) - (most > 1 ? 32 - __clz(most - 1) : 0);
    together_bits = max_of(min_of(bits, 31 - __clz(kTurn)), 0);
  }
};

template <class P>
__device__ __forceinline__ PatchShared<P>* patch_shared() {
  extern __shared__ __align__(16) char memory[];
  return reinterpret_cast<PatchShared<P>*>(memory);
}

enum class Output { kWrite, kMerge };  // alone on the frame, or beside others

// Draws entries into a region: what misses it or lies behind it first falls out, an entry a lane. empty: the region
// holds nothing yet.
template <class Region>
__device__ __forceinline__ void draw_all(const Frame& f, Region& region, const PatchEntry* entries,
                                         const uint16_t* list, int count, bool empty, const Record* records) {
  const int x = region.x(), y = region.y();
  for (int base = 0; base < count; base += kWarp) {
    bool keep = base + lane_id() < count, full = keep;
    float nearest = 0.0f, farthest = kInfinity;
    if (keep) {  // without further branches: all of it is independent of each other
      const PatchEntry& e = entries[list[base + lane_id()]];
#pragma unroll
      for (int k = 0; k < 3; ++k) {
        keep &= highest_over(e.edge[k], x, y, kRegion - 1, Region::kHeight - 1) >= 0;
        full &= lowest_over(e.edge[k], x, y, kRegion - 1, Region::kHeight - 1) >= 0;
      }
      nearest = bound_depth(e, x, y, kRegion - 1, Region::kHeight - 1, false);
      const float behind = bound_depth(e, x, y, kRegion - 1, Region::kHeight - 1, true);
      farthest = full && !e.far() ? behind : kInfinity;
      count_work(f, Counter::tiles_tested, 1);
      count_work(f, Counter::tiles_rejected, !keep);
      count_work(f, Counter::tiles_accepted, full);
      count_work(f, Counter::edges_32, 3 * 2);
    }
    region.bound = min_of(
        region.bound, bits_float(warp_min(float_bits(farthest))));  // depths are not negative: their bits are in order
    count_work(f, Counter::tiles_hidden, keep && nearest > region.bound);
    keep = keep && nearest <= region.bound;
    const unsigned whole = __ballot_sync(kAllLanes, full);
    for (unsigned todo = __ballot_sync(kAllLanes, keep); todo; todo &= todo - 1) {
      const int i = __ffs(todo) - 1;
      count_work(f, Counter::edges_32, lane_id() != 0 || whole >> i & 1 ? 0 : 3 * kRegion * Region::kHeight);
      if constexpr (kCounts) count_fragments(f, region, region.cut, entries[list[base + i]]);
      region.draw(entries[list[base + i]], whole >> i & 1, empty, records);
      empty = false;
    }
  }
}

// The calling warp's region of a patch.
template <class P>
__device__ __forceinline__ typename P::Region region_of(const P& p) {
  const int warp = (int)(this_thread() / kWarp) % P::kRegions;
  typename P::Region region;
  region.left = p.left + (warp & 3) * kRegion;
  region.top = p.top + (warp >> 2) * P::Region::kHeight;
  region.bound = bits_float(p.bound);
  return region;
}

// The block's turn that begins with patch number `first`. By all threads, of which the last warp's do it, for others
// may have more to do; a barrier has to follow.
template <class P, bool kViews>
__device__ __forceinline__ void begin_turn(const Frame& f, int first) {
  PatchShared<P>* const s = patch_shared<P>();
  const int k = (int)this_thread() - (P::kWarps - 1) * kWarp;
  if (k >= 0 && k < kTurn) {
    int i = first + k * (int)gridDim.x;
    if (kViews) {
      const int of_view = P::count(f.view);
      s->view[k] = min_of(i / of_view, f.views - 1);
      i -= s->view[k] * of_view;
    }
    s->patch[k] = P::at(f.view, i);
  }
  if (k == 0) {
    const int count = P::count(f.view) * (kViews ? f.views : 1), turn = kTurn * (int)gridDim.x;
    s->next_turn = first + turn;
    s->last_turn = s->next_turn >= count;
    s->patches = s->last_turn ? (count - first + (int)gridDim.x - 1) / (int)gridDim.x : kTurn;
    s->entry_count = 0;
    s->touched = 0;
    s->resumed = false;
  }
}

// Calls use(box) for candidates i, i + step, ... until it returns true; returns that i, or count. Where there are many,
// four boxes at once, so that their loads do not wait for each other.
template <bool kLists, class Candidates, class Use>
__device__ __forceinline__ int find_box(const Candidates& candidates, int i, int step, int count, const Use& use) {
  constexpr int kAtOnce = 4;
  if (kLists)
    for (; i + (kAtOnce - 1) * step < count; i += kAtOnce * step) {
      decltype(candidates.box(0)) box[kAtOnce];
      for (int k = 0; k < kAtOnce; ++k) box[k] = candidates.box(i + k * step);
      for (int k = 0; k < kAtOnce; ++k)
        if (use(box[k])) return i + k * step;
    }
  for (; i < count; i += step) {
    if (use(candidates.box(i))) return i;
    if (!kLists) break;  // there is only one
  }
  return count;
}

// Makes entries of the candidates for the patches from `group` on, as many as there is room for. By all threads; ends
// with a barrier.
template <class P, class Candidates>
__device__ __forceinline__ void gather(const Frame& f, const Candidates& candidates, int group, int room) {
  constexpr int kThreads = P::kThreads;
  constexpr bool kLists = Candidates::kLists;
  PatchShared<P>* const s = patch_shared<P>();
  const int each = kThreads >> s->together_bits,
            local = (int)(this_thread() >> (31 - __clz(each)));  // each: threads for a patch
  P& patch = s->patch[group + local];
  const int left = patch.left, top = patch.top, view = kLists ? s->view[group + local] : 0;
  // The patch's candidates: first those in the list of its bin, then those of all bins.
  const int listed = kLists ? s->listed[group + local] : 0, count = listed + s->count;
  // This thread's next candidate in the bin of its patch, from i on.
  const auto next = [&](int i) {
    if (kLists && i < listed) return i;
    return listed + find_box<kLists>(candidates, i - listed, each, count - listed,
                                     [&](auto box) { return in_box(box, view, left >> kBinBits, top >> kBinBits); });
  };
  const auto slot_of = [&](int i) {
    if constexpr (kLists)
      if (i < listed) return candidates.listed_slot(view, left >> kBinBits, top >> kBinBits, i);
    return candidates.slot(i - listed);
  };
  int i = s->resumed ? s->cursor[kThreads - 1 - this_thread()] : next((int)(this_thread() & (each - 1)));
  bool more;
  do {
    PatchMeeting m = {kNotANumber};  // all of it, or registers would be kept for what the last round left
    if (i < count) {
      const int slot = slot_of(i);
      meet_patch(candidates.records[slot], (uint32_t)slot, left >> kBinBits, top >> kBinBits, 0, top & (kBin - 1), kBin,
                 P::kRows, &m);
      count_meeting(f, m, Counter::bins_tested, Counter::bins_rejected, Counter::bins_accepted);
      if (m.farthest < kInfinity) atomicMin(&patch.bound, float_bits(m.farthest));
    }
    __syncthreads();
    // What a patch is covered by hides what lies behind. Only what is left takes room.
    bool pending = false;
    count_work(f, Counter::bins_hidden, m.nearest > bits_float(patch.bound));
    if (m.nearest <= bits_float(patch.bound)) {
      const int place = atomicAdd(&s->entry_count, 1);
      pending = place >= room;
      count_work(f, pending ? Counter::overflows : Counter::entries, 1);
      if (!pending) {
        m.make_entry(candidates.records[m.slot()], &s->entries[place]);
        const int before = atomicAdd(&patch.waiting, kLists ? 1 : patch.added_by(candidates.records[m.slot()]));
        s->list[local * each + P::entries_in(before)] = (uint16_t)place;
      }
    }
    if (i < count && !pending) i = next(i + each);
    more = kLists && __syncthreads_or(i < count) && s->entry_count <= room;
  } while (more);
  if (!kLists) __syncthreads();
  if (s->entry_count > room) s->cursor[kThreads - 1 - this_thread()] = i;
}

// Notes how many candidates each patch of the turn has in the list of its bin, and so how many patches are looked at
// together. By all threads; ends with a barrier.
template <class P, class Candidates>
__device__ __forceinline__ void measure_lists(const Candidates& candidates) {
  PatchShared<P>* const s = patch_shared<P>();
  const int k = (int)this_thread();
  if (k < kWarp) {
    if (k < kTurn)
      s->listed[k] = k < s->patches ? candidates.listed(s->view[k], s->patch[k].bin_x(), s->patch[k].bin_y()) : 0;
    __syncwarp();
    if (k == 0) {
      int most = 0;
      for (int n : s->listed) most = max_of(most, n);
      s->look_at(most + s->count);
    }
  }
  __syncthreads();
}

// Looks at the candidates once for all patches of the turn: which of them have any. By all threads; ends with a
// barrier.
template <class P, class Candidates>
__device__ __forceinline__ void find_touched(const Candidates& candidates) {
  constexpr int kThreads = P::kThreads;
  PatchShared<P>* const s = patch_shared<P>();
  unsigned touched = 0;
  if (this_thread() < kTurn && s->listed[this_thread()] > 0) touched = 1u << this_thread();
  find_box<true>(candidates, (int)this_thread(), kThreads, s->count, [&](auto box) {
#pragma unroll
    for (int k = 0; k < kTurn; ++k)
      touched |= in_box(box, s->view[k], s->patch[k].bin_x(), s->patch[k].bin_y()) ? 1u << k : 0;
    return false;
  });
  if (touched) atomicOr(&s->touched, touched);
  __syncthreads();
}

// Draws what is in the list into a region of a view. empty: nothing has been drawn there yet, or what is drawn is
// merged.
template <Output kOutput, class Region>
__device__ __forceinline__ void draw_region(const Frame& f, int view, Region& region, const PatchEntry* entries,
                                            const uint16_t* list, int count, bool empty, const Record* records) {
  if constexpr (kCounts && kOutput == Output::kWrite)
    region.each(f, [&](int, uint32_t) { count_work(f, Counter::written, 1); });
  if (kOutput == Output::kWrite && count == 0) {
    region.clear();
    region.store(f);
  } else if (kOutput == Output::kWrite && empty && count == 1 && entries[list[0]].alone() && region.whole(f)) {
    if constexpr (kCounts) count_fragments(f, region, ~0u, entries[list[0]]);
    region.fill(entries[list[0]], records);
    region.store(f);
  } else {
    region.begin(f);
    region.clear();
    if (!empty) region.load(f);
    draw_all(f, region, entries, list, count, empty, records);
    if (kOutput == Output::kWrite)
      region.store(f);
    else
      region.merge(f, view);
  }
}

// The same by rows, of a whole patch. By all threads.
template <class P>
__device__ __forceinline__ void draw_patch_by_rows(const Frame& f, const P& patch, const uint16_t* list, bool empty,
                                                   const Record* records) {
  PatchShared<P>* const s = patch_shared<P>();
  typename P::Region region = region_of(patch);
  const bool has_region = this_thread() < P::kRegions * kWarp;
  if (empty && has_region) {
    if constexpr (kCounts) region.each(f, [&](int, uint32_t) { count_work(f, Counter::written, 1); });
    region.clear();
    region.store_packed(f);
  }
  __syncthreads();
  draw_patch_rows<P::kRows, P::kThreads>(f, patch.left, patch.top, s->entries, list, patch.entries(), records,
                                         s->spans + (this_thread() & ~(kWarp - 1)));
  if (!f.depth) return;
  __syncthreads();
  if (!has_region) return;
  region.load(f);
  region.store_depth(f);
}

// Draws the patches that are this block's, by all of its threads. What can be seen gathers in shared memory; then each
// warp draws its region of each patch, the pixels in registers, mostly once, or all warps draw rows of a patch. If more
// gathers than there is room for, the patches are drawn several times, each time from what the last one left. Before:
// begin_turn(f, blockIdx.x), PatchShared::begin, a barrier. Candidates: const Record* records; of those that all patches
// look at box(int i), for in_box, and int slot(int i); kLists: there can be more of them than threads, there are lists for
// each bin besides, int listed(int view, int bin_x, int bin_y), int listed_slot(int view, int bin_x, int bin_y, int i), and
// the frame may have several views. With kLists all is merged into the frame, without it written.
template <class P, class Candidates>
__device__ __forceinline__ void draw_patches(const Frame& f, const Candidates& candidates, int room) {
  constexpr int kThreads = P::kThreads;
  constexpr bool kLists = Candidates::kLists;
  constexpr Output kOutput = kLists ? Output::kMerge : Output::kWrite;
  PatchShared<P>* const s = patch_shared<P>();
  room = min_of(room, P::kMaxEntries);
  for (;;) {
    if constexpr (kLists) {
      measure_lists<P>(candidates);
      if (s->together_bits == 0) find_touched<P>(candidates);
    }
    for (int group = 0;;) {
      if (kLists && reread(s->together_bits) == 0)  // then a group is one patch
        while (group < s->patches && !(s->touched >> group & 1)) ++group;
      if (group >= reread(s->patches)) break;
      gather<P>(f, candidates, group, room);
      const int together_bits = s->together_bits;
      const bool again = s->drawn | s->resumed;
#pragma unroll 1
      for (int k = 0; k < min_of(1 << together_bits, s->patches - group); ++k) {
        const P patch = s->patch[group + k];
        if (patch.waiting == 0 && (kOutput == Output::kMerge || again)) continue;
        const uint16_t* const list = s->list + k * (kThreads >> together_bits);
        const bool empty = kOutput == Output::kMerge || !again;
        if constexpr (!kLists)
          if (patch.by_rows() && reread(s->entry_count) <= room) {
            draw_patch_by_rows(f, patch, list, empty, candidates.records);
            continue;
          }
        if (k % P::kTeams != (int)(this_thread() / kWarp) / P::kRegions) continue;  // another team's
        typename P::Region region = region_of(patch);
        draw_region<kOutput>(f, kLists ? s->view[group + k] : 0, region, s->entries, list, patch.entries(), empty,
                             candidates.records);
      }
      const bool finished = reread(s->entry_count) <= room;
      group += finished ? 1 << together_bits : 0;
      if (group >= reread(s->patches) && reread(s->last_turn)) return;
      __syncthreads();
      if (this_thread() < kTurn) s->patch[this_thread()].waiting = 0;
      if (this_thread() == 0) {
        s->entry_count = 0;
        s->resumed = !finished;
      }
      __syncthreads();
    }
    if (reread(s->last_turn)) return;
    const int next = reread(s->next_turn);
    __syncthreads();  // nobody looks at the patches of this turn any more
    begin_turn<P, kLists>(f, next);
    __syncthreads();
  }
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri
