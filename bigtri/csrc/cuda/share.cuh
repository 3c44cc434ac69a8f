// What becomes of a block's share of the triangles: set-up, drawing by rows or boxes, and what is left to the caller.
#pragma once

#include "filed.cuh"
#include "primitives.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

// Shared memory of a block.
template <Way kWay>
struct ShareShared {
  static constexpr int kWarps = block_warps(kWay);

  WarpShared warp[kWarps];
  Search search[tests(kWay) ? kWarps : 1];
  Clips clips[together(kWay) ? most_groups(kWay) : kWarps];
  uint32_t claimed[2];  // tested: what the block draws next, if all are drawn
  int row_counts[kWarps];  // triangles drawn by rows: together of each group; even of each warp that leaves rows to all
  union {
    int next_row[kWarps];  // even: the first of these rows
    int group_rows[most_groups(kWay)];  // in groups: how many rows each has
  };
  __device__ ShareShared() {}

  // Together: a group's corners. Its triangles end up in the memory of the warp that sets them up.
  __device__ __forceinline__ Vertex* corners_of(int group) { return warp[most_groups(kWay) + group].corners; }
};
static_assert(sizeof(ShareShared<Way::kEven>) <= 48 * 1024 && sizeof(ShareShared<Way::kInGroups>) <= 48 * 1024,
              "as much as a block can have without asking");

// The corners of triangle t, projected by this thread alone.
__device__ __forceinline__ void own_corners(const Frame& f, int64_t first, int32_t t, Vertex v[3]) {
  int32_t index[3];
  for (int k = 0; k < 3; ++k) index[k] = __ldg(f.triangles + 3 * (int64_t)t + k);
#pragma unroll 1
  for (int k = 0; k < 3; ++k) {
    v[0] = v[1];
    v[1] = v[2];
    v[2] = {0, 0, 0.0f, kNonFinite};
    if (index[0] >= 0 && index[0] < f.vertices) v[2] = load_and_project(f, first + index[0]);
    index[0] = index[1];
    index[1] = index[2];
  }
}

// The same of a share that is drawn together, a thread each, where corners_of() has room for each group.
template <Way kWay>
__device__ __forceinline__ void make_corners(const Frame& f, int64_t first_vertex, const Share& share, int group,
                                             ShareShared<kWay>* shared) {
  constexpr int kGroups = most_groups(kWay), kThreads = block_threads(kWay);
  static_assert(2 * kGroups <= block_warps(kWay), "corners_of() has room beside the groups");
#pragma unroll
  for (int first = 0; first < 3 * kGroups * kWarp; first += kThreads) {
    const int c = first + (int)threadIdx.x, number = c / 3;
    if (c >= 3 * share.count) return;
    int at = 0;
#pragma unroll
    for (int next = 1; next < kGroups; ++next) at += number >= next * group;
    const int32_t index = __ldg(f.triangles + 3 * (int64_t)(share.first + number * share.step) + (c - 3 * number));
    Vertex* const corner = shared->corners_of(at) + (c - 3 * at * group);
    *corner = {0, 0, 0.0f, kNonFinite};
    if (index >= 0 && index < f.vertices) *corner = load_and_project(f, first_vertex + index);
  }
}

// Draws the rows that the block's warps have left, 32 at a time by each warp in turn. By all threads. Rarely called, so
// that its registers cost the others nothing.
template <Way kWay>
__device__ __noinline__ void draw_left_rows(FramePixel pixels, int width, int warp, ShareShared<kWay>* shared) {
  constexpr int kWarps = block_warps(kWay);
#pragma unroll 1
  for (int owner = 0; owner < kWarps; ++owner) {
    const int count = shared->row_counts[owner], turn = (warp + owner) % kWarps;  // another one begins with each
    if (count > 0)
      draw_rows<false>(pixels, width, shared->warp[owner].triangle, count, shared->next_row[owner], turn,
                       log_block_warps(kWay), INT32_MAX, &shared->warp[warp].rows);
  }
}

// What a warp draws triangles of its block's share with.
template <Way kWay>
struct Drawing {
  static constexpr bool kTogether = together(kWay), kLeaves = kWay == Way::kEven;
  static constexpr int kGroups = most_groups(kWay);
  static constexpr bool kSamples = kTogether || kLeaves;  // the others' are 64 px wide at most, hardly large
  static constexpr int kWarps = block_warps(kWay);

  const Frame& f;
  const Sharing& sharing;
  const Share share;
  const Vertex* own_projected;  // of the view, or null
  const int64_t first_vertex;  // of the view
  const FramePixel pixels;
  const RowLimits& limits;
  const int warp;
  ShareShared<kWay>* const shared;

  // Computed anew wherever it is asked for, which takes fewer instructions than to keep it.
  __device__ __forceinline__ Team team() const {
    return kWay == Way::kInTeams ? Team::of_block(computed_here(sharing.log_team)) : Team{};
  }
  // The group that the warp sets up, if any. With one group it is warp 0's, which takes no register.
  __device__ __forceinline__ int own_group() const { return kGroups > 1 ? warp : 0; }

  struct Made {
    Filed filed;
    int clips;
  };

  // Sets up triangle t of each lane below `count`. Files them, or draws them by boxes where most are small; lists what has to be
  // clipped, and says how many. By all lanes.
  __device__ __forceinline__ Made set_up(int32_t t, int count, Clips* clips) const {
    WarpShared* const s = &shared->warp[warp];
    Fate fate = Fate::kNothing;
    Primitive p;
    // A variable of a loop that is not set on every path stays alive from one round to the next, so that it spills.
    if (tests(kWay)) p = {};
    if (lane_id() < count) {
      Vertex v[3];
      if (kTogether)
        for (int k = 0; k < 3; ++k) v[k] = shared->corners_of(own_group())[3 * lane_id() + k];
      else if (tests(kWay) || own_projected)
        projected_corners(f, own_projected, t, v);
      else
        own_corners(f, first_vertex, t, v);
      fate = assemble(f, v, &p);
      if constexpr (kUnsnapped)
        if (fate == Fate::kWhole) load_places(f, first_vertex, t, &p);
    }
    const bool clipped = fate == Fate::kClip && team().own(), have = fate == Fate::kWhole;
    const unsigned clip = __ballot_sync(kAllLanes, clipped), dropped = __ballot_sync(kAllLanes, fate == Fate::kDropped);
    if (clipped) clips->triangle[__popc(clip & lanes_below())] = t;
    if (dropped && team().first()) count_dropped(f, share.view, dropped);
    Filed filed = {0, 0};
    const bool small = !kTogether && have && is_small(p);
    if (!kTogether && __popc(__ballot_sync(kAllLanes, small)) >= kMostlySmall) {
      const unsigned left = __ballot_sync(kAllLanes, have && !small);
      if (have && !small) s->left[__popc(left & lanes_below())].put(p, t);
      count_work(f, Counter::records, small);
      count_work(f, Counter::by_rows, small);
      draw_small(pixels, f.view.width, p, (uint32_t)(f.first_triangle + t), small, &s->small);
      if (left) filed = file_left(f, share.view, __popc(left), limits, s);
    } else if (__any_sync(kAllLanes, have)) {
      filed = file<kSamples>(f, p, f.first_triangle + t, share.view, have, limits, team(), s);
    }
    return {filed, __popc(clip)};
  }

  // The triangle that is clipped as the n-th of the block, or -1. Together.
  __device__ __forceinline__ int32_t clipped_at(int n) const {
#pragma unroll 1
    for (int group = 0; group < (kGroups > 1 ? sharing.groups : 1); ++group) {
      const Clips& clips = shared->clips[group];
      if (n < clips.count) return clips.triangle[n];
      n -= clips.count;
    }
    return -1;
  }

  // Together: sets up triangle t of each lane below `count` if the warp has a group, and draws the triangles of all groups with
  // the block's other warps; what is not drawn by rows goes to `rest`. By all threads.
  template <class Rest>
  __device__ __forceinline__ void draw_together(int32_t t, int count, const Rest& rest) const {
    WarpShared* const s = &shared->warp[warp];
    const int groups = kGroups > 1 ? sharing.groups : 1;
    Filed filed = {0, 0};
    int clips = 0;
    if (kGroups > 1 ? count > 0 : warp == 0) {
      const Made made = set_up(t, count, &shared->clips[own_group()]);
      filed = made.filed;
      clips = made.clips;
    }
    const int rows = kGroups > 1 ? warp_sum(lane_id() < filed.rows ? rows_of(s->triangle[lane_id()]) : 0) : 0;
    if (threadIdx.x < kGroups * kWarp && threadIdx.x % kWarp == 0) {
      shared->row_counts[own_group()] = filed.rows;
      if (kGroups > 1) shared->group_rows[own_group()] = rows;
      shared->clips[own_group()].count = clips;
    }
    __syncthreads();
    // What has to be clipped goes round among the warps that have set up no group, whose memory is not in use.
    int group = 0, next_clipped = warp >= groups ? warp - groups : INT32_MAX;
    bool whole = true;  // whether it is a group's triangles, all warps', and not parts of one that the warp has clipped
#pragma unroll 1
    for (;;) {
      const int count = whole ? shared->row_counts[group] : filed.rows;
      const int turn = kGroups > 1 ? (warp + 3 * group) % kWarps : warp;  // another one begins with each
      // In groups, most warps have none of a group's rows, and would take 1,000 cycles to find that out.
      if (kGroups > 1 && whole ? turn * kWarp < shared->group_rows[group] : count > 0)
        draw_rows<false, kWay == Way::kInTeams>(pixels, f.view.width, shared->warp[whole ? group : warp].triangle,
                                                count, 0, whole ? (turn << team().log_size) + team().member : 0,
                                                whole ? log_block_warps(kWay) + team().log_size : 0, INT32_MAX,
                                                &s->rows);
      if (kGroups > 1 && whole && ++group < groups) continue;
      if (filed.rest > 0) {
        wait_for_previous();
        rest(share.view, s->records_end() - filed.rest, filed.rest);
      }
      const int32_t clipped = clipped_at(next_clipped);
      if (clipped < 0) break;
      filed = clip_and_file<kSamples>(f, share.view, clipped, limits, s);
      next_clipped += kWarps - groups;
      whole = false;
    }
  }

  // The other ways: sets up triangle t of each lane below `count`, and draws all but what has to be clipped; even, it leaves rows
  // to the block if there are too many. By all lanes.
  template <class Rest>
  __device__ __forceinline__ void draw_own(int32_t t, int count, const Rest& rest) const {
    WarpShared* const s = &shared->warp[warp];
    const Made made = set_up(t, count, &shared->clips[warp]);
    shared->clips[warp].count = made.clips;
    if (kLeaves) shared->row_counts[warp] = 0;
    if (made.filed.rows > 0) {
      // Where it clips too, which takes the memory of these, it draws them all.
      const int next = draw_rows<kLeaves>(pixels, f.view.width, s->triangle, made.filed.rows, 0, 0, 0,
                                          made.clips > 0 ? INT32_MAX : sharing.own_pixels, &s->rows);
      if (kLeaves && next >= 0) {
        shared->row_counts[warp] = made.filed.rows;
        shared->next_row[warp] = next;
      }
    }
    if (made.filed.rest > 0) {
      wait_for_previous();
      rest(share.view, s->records_end() - made.filed.rest, made.filed.rest);
    }
    __syncwarp();
  }

  // Draws of what warp `owner` has to clip what falls to this one, if it goes round among so many. By all lanes.
  template <class Rest>
  __device__ __forceinline__ void draw_clipped_of(int owner, int first, int warps, const Rest& rest) const {
    draw_clipped<kSamples>(f, share.view, &shared->clips[owner], first, warps, limits, &shared->warp[warp], rest);
  }
};

// Even and apart: draws what the warps have left. By all threads, which have drawn their own.
template <Way kWay, class Rest>
__device__ __forceinline__ void draw_left(const Drawing<kWay>& drawing, const Rest& rest) {
  constexpr int kWarps = block_warps(kWay);
  ShareShared<kWay>* const shared = drawing.shared;
  const int warp = drawing.warp;
  if (kWay == Way::kEven) {  // what it clips a warp draws before rows are left to it, while others draw their own
    if (shared->clips[warp].count > 0) drawing.draw_clipped_of(warp, 0, 1, rest);
    if (__syncthreads_or(shared->row_counts[warp])) draw_left_rows(drawing.pixels, drawing.f.view.width, warp, shared);
  } else if (__syncthreads_or(shared->clips[warp].count)) {  // neighbours, of which one warp may have many
    int before = 0;
#pragma unroll 1
    for (int owner = 0; owner < kWarps; ++owner) {
      drawing.draw_clipped_of(owner, (warp + kWarps - before % kWarps) % kWarps, kWarps, rest);
      before += shared->clips[owner].count;
    }
  }
}

// Tested: draws the warp's triangles from `begin` on, up to `end`. By all lanes.
template <Way kWay, class Rest>
__device__ __forceinline__ void draw_tested(const Drawing<kWay>& drawing, int32_t begin, int32_t end, Search* search,
                                            const Rest& rest) {
  search->begin(begin, true);
  const int& clips = drawing.shared->clips[drawing.warp].count;
  bool more;
#pragma unroll 1
  do {
    do {
      const int count = find_waiting(drawing.f, drawing.own_projected, drawing.share.step, end, search);
      drawing.draw_own(search->list[search->waiting + min_of(lane_id(), max_of(count - 1, 0))], count, rest);
      more = search->goes_on(end);
    } while (more && reread(clips) == 0);
    if (reread(clips) > 0)
      drawing.draw_clipped_of(drawing.warp, 0, 1, rest);  // outside of the loop, whose registers it would take
  } while (more);
}

// Tested, if nearly all triangles of the only view show: draws them untested, as many in a row as the block has threads, and
// then as many again that it claims, for some blocks of a multiprocessor are slower than others. Warps that claimed each for
// itself took longer. By all threads.
template <Way kWay, class Rest>
__device__ __forceinline__ void draw_all(const Drawing<kWay>& drawing, const Rest& rest) {
  constexpr int kThreads = block_threads(kWay);
  const Frame& f = drawing.f;
  ShareShared<kWay>* const shared = drawing.shared;
  const int warp = drawing.warp;
  int64_t first = (int64_t)blockIdx.x * kThreads;
#pragma unroll 1
  for (int at = 0; first < f.count; at ^= 1) {  // two places, for a warp may read one while another has gone on
    if (threadIdx.x == 0) shared->claimed[at] = atomicAdd(&drawing.sharing.sample->claimed, 1u);
    const int32_t own = (int32_t)first + warp * kWarp;
    drawing.draw_own(own + lane_id(), max_of(min_of(kWarp, f.count - own), 0), rest);
    if (reread(shared->clips[warp].count) > 0) drawing.draw_clipped_of(warp, 0, 1, rest);
    __syncthreads();
    first = ((int64_t)reread(shared->claimed[at]) + gridDim.x) * kThreads;
  }
}

// Sets up a block's share and draws what fits by rows. What is left goes to rest(view, records, their number), which
// all lanes of a warp call after the kernels in front have ended. Parts of clipped triangles take the same way as whole
// triangles. projected: the vertices of all views, or null. By all threads of a block.
template <Way kWay, class Rest>
__device__ __forceinline__ void draw_share(const Frame& f, const Sharing& sharing, const Vertex* projected,
                                           const RowLimits& limits, ShareShared<kWay>* shared, const Rest& rest) {
  constexpr bool kTogether = together(kWay);
  const int warp = computed_here((int)(threadIdx.x / kWarp));
  const Share share = share_of<kWay>(f, sharing);
  if ((!kTogether && projected) || share.count <= 0) wait_for_previous();
  if (share.count <= 0) return;
  const int64_t first_vertex = share.view * (f.view_stride / 4);
  const Drawing<kWay> drawing = {
      f,      sharing, share, projected ? projected + first_vertex : nullptr, first_vertex, first_pixel(f, share.view),
      limits, warp,    shared};
  if constexpr (kTogether) {
    make_corners(f, first_vertex, share, sharing.group, shared);  // a thread each, which takes a third of the time
    __syncthreads();
    const int first = drawing.own_group() * sharing.group;
    int count = min_of(sharing.group, share.count - first);
    if (most_groups(kWay) == 1) count = warp == 0 ? share.count : 0;
    drawing.draw_together(share.first + (first + lane_id()) * share.step, count, rest);
  } else if constexpr (tests(kWay)) {
    if (sharing.sample && sharing.sample->shown >= kMostShown) return draw_all(drawing, rest);
    draw_tested(drawing, share.first + min_of(warp * share.apart, share.count), share.first + share.count,
                &shared->search[warp], rest);
  } else {
    const int place = warp * sharing.group + lane_id(), log = sharing.log_neighbours;
    const int64_t offset = (int64_t)(place >> log) * share.step + (place & ((1 << log) - 1));
    const bool have = lane_id() < sharing.group && offset < share.count;
    drawing.draw_own(share.first + (int32_t)offset, __popc(__ballot_sync(kAllLanes, have)), rest);
    draw_left(drawing, rest);
  }
  wait_for_previous();
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri
