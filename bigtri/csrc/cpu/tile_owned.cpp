// The tile_owned variant: a task owns tiles of 16x16 px, each with a list of the records that touch it, and writes every
// pixel once. The lists are a counting sort: set-up counts the records of each tile, a prefix sum gives each list its
// place, and a second loop fills them. Depth bounds of a tile and of its four quads then hide most of what lies behind.
//
// It has the opposite costs of an atomic minimum for each pixel: no fragment is written that is not seen, but a large
// record has an entry in every tile that it touches. The binding calls draw() through the registry.

#include "kernels.h"
#include "shares.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

constexpr Parameter kParameters[] = {{"share", "triangles", "triangles that a task sets up", 256, 1, 1 << 20},
                                     {"tiles", "tiles", "owned tiles, of 16x16 px, that a task draws", 16, 1, 1 << 20},
                                     {}};
enum { kShare, kTiles };

// A record in a tile, before there are lists. record: of its share.
struct Pair {
  int64_t tile;
  OwnedEntry entry;
};

// The owned tiles of the views of a round, and their lists.
class Lists {
 public:
  Lists(const ProjectedFrame& frame, const Parallel& parallel, Round* round)
      : columns_((frame.view.width + kOwnedTile - 1) / kOwnedTile),
        of_view_((int64_t)columns_ * ((frame.view.height + kOwnedTile - 1) / kOwnedTile)),
        first_view_(round->first_view),
        begin_((size_t)(round->views * of_view_ + 1), 0) {
    std::vector<std::vector<Pair>> pairs((size_t)round->count);
    round->set_up(frame, parallel, [&](int64_t share, const Record* r, Counts* counts) {
      list_tiles(*r, (uint32_t)(r - round->records[(size_t)share].data()), &pairs[(size_t)share], counts);
    });
    place_lists();
    // Records of all shares, one after the other.
    std::vector<uint32_t> first((size_t)round->count + 1, 0);
    for (size_t i = 0; i < round->records.size(); ++i) first[i + 1] = first[i] + (uint32_t)round->records[i].size();
    records_.resize(first.back());
    entries_.resize((size_t)begin_.back());
    std::vector<int64_t> next(begin_.begin(), begin_.end() - 1);
    parallel(round->count, [&](int64_t i) {
      std::copy(round->records[(size_t)i].begin(), round->records[(size_t)i].end(),
                records_.begin() + first[(size_t)i]);
      for (Pair& pair : pairs[(size_t)i]) {
        pair.entry.record += first[(size_t)i];
        entries_[(size_t)__atomic_fetch_add(&next[(size_t)pair.tile], 1, __ATOMIC_RELAXED)] = pair.entry;
      }
    });
  }

  int64_t of_view() const { return of_view_; }

  void draw(const ProjectedFrame& frame, int64_t tile, bool begun, Counts* counts) const {
    const int64_t in_view = tile % of_view_, count = begin_[(size_t)tile + 1] - begin_[(size_t)tile];
    const Square square = square_of(frame, first_view_ + tile / of_view_, (int)(in_view % columns_) * kOwnedTile,
                                    (int)(in_view / columns_) * kOwnedTile, kOwnedTile);
    alignas(64) int64_t pixels[kOwnedPixels];
    if (begun)
      load_square(square, pixels);
    else
      std::fill_n(pixels, kOwnedPixels, kBackground);
    if (count)
      current_kernels().tile_owned.draw_list(records_.data(), entries_.data() + begin_[(size_t)tile], count, square.x,
                                             square.y, pixels, counts);
    if (count || !begun) store_square(square, pixels, counts);
  }

 private:
  // Bin by bin, so that a record is tested against 64 px before it is against 8.
  void list_tiles(const Record& r, uint32_t record, std::vector<Pair>* pairs, Counts* counts) {
    const BinBox box = bin_box(r);
    for (int n = 0; n < box.count; ++n) {
      const int bin_x = box.x + n % box.columns, bin_y = box.y + n / box.columns;
      bool kept = true;
      for (int k = 0; k < 3; ++k) kept &= bin_edge(edge_of(r.x, r.y, k), bin_x, bin_y).highest >= 0;
      counts->add(Counter::candidates, 1);
      counts->add(Counter::bins_tested, 1);
      counts->add(Counter::bins_rejected, !kept);
      counts->add_edges(Counter::edges_64, 3, bin_x * kBin, bin_y * kBin, kBin);
      if (!kept) continue;
      uint64_t touched, full;
      current_kernels().tile_owned.find_quads(r, bin_x, bin_y, &touched, &full, counts);
      for (int row = 0; row < kBin / kTile; row += 2)
        for (int column = 0; column < kBin / kTile; column += 2) {
          const OwnedEntry entry = {record, quads(touched, column, row), quads(full, column, row)};
          if (!entry.touched) continue;
          const int x = (bin_x * kBin + column * kTile) / kOwnedTile, y = (bin_y * kBin + row * kTile) / kOwnedTile;
          const int64_t tile = (r.view - first_view_) * of_view_ + (int64_t)y * columns_ + x;
          __atomic_fetch_add(&begin_[(size_t)tile + 1], 1, __ATOMIC_RELAXED);
          pairs->push_back({tile, entry});
          counts->add(Counter::entries, 1);
          counts->add(Counter::bytes, sizeof(Pair) + sizeof(OwnedEntry));
          counts->add(Counter::atomics, 2);  // here, and where the list is filled
        }
    }
  }

  // Of a mask of 8x8 tiles, four that are an owned tile.
  static uint8_t quads(uint64_t mask, int column, int row) {
    const uint64_t upper = mask >> (8 * row + column) & 3, lower = mask >> (8 * (row + 1) + column) & 3;
    return (uint8_t)(upper | lower << 2);
  }

  void place_lists() {
    for (size_t tile = 1; tile < begin_.size(); ++tile) begin_[tile] += begin_[tile - 1];
  }

  int columns_;
  int64_t of_view_, first_view_;
  std::vector<int64_t> begin_;  // [tiles + 1], of the lists in entries_; until they are placed, their lengths
  std::vector<Record> records_;
  std::vector<OwnedEntry> entries_;
};

void draw(const ProjectedFrame& frame, const Parallel& parallel, const int64_t* values) {
  const bool clears = !has_whole_views(frame, values[kShare]);
  if (clears)
    clear_image(frame, parallel);
  else
    std::fill_n(frame.dropped, frame.views, 0);
  const int64_t together = values[kTiles];
  each_round(frame, values[kShare], [&](Round& round) {
    const Lists lists(frame, parallel, &round);
    const int64_t tasks = (lists.of_view() + together - 1) / together;
    parallel(round.views * tasks, [&](int64_t i) {
      Counts counts(frame.map);
      const int64_t first = i / tasks * lists.of_view(), begin = i % tasks * together;
      for (int64_t tile = begin; tile < std::min(begin + together, lists.of_view()); ++tile)
        lists.draw(frame, first + tile, clears, &counts);
      counts.publish_task(frame.counters);
    });
  });
  write_depth_image(frame, parallel);
}

}  // namespace

extern const Variant tile_owned_variant;
const Variant tile_owned_variant = {"tile_owned",
                                    "a list for each 16 px tile, owned tiles, bounds of depth: this project's own",
                                    kParameters, draw_groups<draw>, /*shades=*/false};

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri
