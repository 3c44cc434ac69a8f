// The hierarchical_tiles variant, Merchante's: a pyramid of tiles, each level twice as wide as the one below. Set-up stores
// a record at the finest level at which its bounding box meets few tiles, in the list of each that no edge rejects. Lists
// have a fixed room, which grows by level; what finds its list full goes to a global list, which is sorted by tile before
// anything is drawn, so that nothing is lost. Then a task owns the finest tiles of a bin: for each of them it walks up the
// pyramid, draws what the lists name into its own memory, and stores each pixel once. The binding calls draw() through the
// registry.

#include <algorithm>
#include <memory>
#include <vector>

#include "kernels.h"
#include "shares.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

constexpr int64_t kTileSizes[] = {0, 4, 8, 16, 32, 64, -1};
constexpr int kMostLevels = 13;  // tiles of 4 px, and above them up to the widest image
constexpr int64_t kMostRoom = 1 << 16;
constexpr Parameter kParameters[] = {
    {"share", "triangles", "triangles that a task sets up", 256, 1, 1 << 20},
    {"tile", "px", "of the finest tiles; 0: 64, a task's tiles in one", 0, 0, 64, kTileSizes},
    {"levels", "", "of the pyramid; 0: up to a tile that holds the image", 0, 0, kMostLevels},
    {"meets", "tiles", "that a triangle may meet at the level where it is stored, unless that is the last; 0: 16", 0, 0,
     1 << 20},
    {"room", "elements",
     "in the list of a finest tile, twice as many a level up; what finds its list full goes to a global one; 0: by the "
     "number of triangles",
     0, 0, kMostRoom},
    {"early_z", "", "1: a triangle behind one that fills a finest tile is left out there", 1, 0, 1},
    {}};
enum { kShare, kTileSize, kLevels, kMeets, kRoom, kEarlyZ };

// Bound on memory: elements that all lists have room for, 8 bytes each. Records are bounded by kSharesTogether.
constexpr int64_t kMostSlots = 1 << 24;

// One level of the pyramid of a view.
struct Level {
  int size;  // of a tile, px
  int columns, rows;  // tiles
  int64_t first_tile, first_slot;  // among those of all levels
  int64_t room;  // of a list
};

// The pyramid's shape. What the caller leaves open is chosen by what the host knows: the image's size and the number of
// triangles. docs/variants.md has the measurements.
struct Shape {
  std::vector<Level> levels;
  int64_t meets, tiles, slots;

  Shape(const ProjectedFrame& frame, const int64_t* values) : meets(values[kMeets] ? values[kMeets] : 16) {
    const int width = frame.view.width, height = frame.view.height;
    const int finest = values[kTileSize] ? (int)values[kTileSize] : kBin;
    int count = (int)values[kLevels];
    if (!count)
      for (count = 1; finest << (count - 1) < std::max(width, height);) ++count;
    int64_t room = values[kRoom];
    const int64_t columns = (width + finest - 1) / finest, rows = (height + finest - 1) / finest;
    if (!room) room = std::clamp<int64_t>(8 * (int64_t)frame.count / (columns * rows), 16, 4096);
    tiles = slots = 0;
    for (int i = 0; i < count; ++i) {
      const int size = finest << i;
      const int across = (width + size - 1) / size, down = (height + size - 1) / size;
      // Twice the room of the level below, unless the memory of all lists would be too much.
      const int64_t most = kMostSlots / count / ((int64_t)across * down);
      levels.push_back({size, across, down, tiles, slots, std::min(room << i, std::max<int64_t>(most, 1))});
      tiles += (int64_t)across * down;
      slots += (int64_t)across * down * levels.back().room;
    }
  }
};

// The tiles of a level that a record's bounding box meets.
struct TileBox {
  int x0, y0, x1, y1;  // half-open
  int64_t count() const { return (int64_t)(x1 - x0) * (y1 - y0); }
};
TileBox tile_box(const Record& r, int size) {
  return {r.x0 / size, r.y0 / size, (r.x1 - 1) / size + 1, (r.y1 - 1) / size + 1};
}

// An element that found its list full.
struct Overflow {
  int64_t tile;  // of the round's views
  TileElement element;
};

// The lists of all tiles of some views. Tiles are numbered by view, level, row and column.
class Pyramid {
 public:
  Pyramid(const Shape& shape, int64_t first_view, int64_t views)
      : shape_(shape),
        first_view_(first_view),
        sizes_((size_t)(views * shape.tiles), 0),
        slots_(new TileElement[(size_t)(views * shape.slots)]) {}

  // Stores a record in the lists of its tiles, or in `full`. Any thread may call it.
  void store(const Record* r, std::vector<Overflow>* full, Counts* counts) {
    const Level* level = shape_.levels.data();
    while (level != &shape_.levels.back() && tile_box(*r, level->size).count() > shape_.meets) ++level;
    const TileBox box = tile_box(*r, level->size);
    Edge e[3];
    for (int k = 0; k < 3; ++k) e[k] = edge_of(r->x, r->y, k);
    for (int y = box.y0; y < box.y1; ++y)
      for (int x = box.x0; x < box.x1; ++x) {
        // In 64 bits: f over a tile may be anything, and so is a step times the tile's size.
        int64_t high = 0, low = 0;
        for (int k = 0; k < 3; ++k) {
          const int64_t f = edge_steps(e[k], x * level->size, y * level->size), last = level->size - 1;
          high |= f + last * ((int64_t)max_of(-e[k].dy, 0) + max_of(e[k].dx, 0));
          low |= f + last * ((int64_t)min_of(-e[k].dy, 0) + min_of(e[k].dx, 0));
        }
        counts->add(Counter::candidates, 1);
        counts->add(Counter::bins_tested, 1);
        counts->add(Counter::bins_rejected, high < 0);
        counts->add(Counter::bins_accepted, low >= 0);
        counts->add_edges(Counter::edges_64, high < 0 ? 3 : 6, x * level->size, y * level->size, level->size);
        if (high < 0) continue;
        const int64_t view = r->view - first_view_, in_level = (int64_t)y * level->columns + x;
        const int64_t tile = view * shape_.tiles + level->first_tile + in_level;
        const int64_t place = __atomic_fetch_add(&sizes_[(size_t)tile], 1, __ATOMIC_RELAXED);
        const TileElement element = TileElement::of(r, low >= 0);
        counts->add(Counter::entries, 1);
        counts->add(Counter::atomics, 1);
        counts->add(Counter::bytes, sizeof(TileElement));
        if (place < level->room) {
          slots_[view * shape_.slots + level->first_slot + in_level * level->room + place] = element;
        } else {
          full->push_back({tile, element});
          counts->add(Counter::overflows, 1);
          counts->add(Counter::bytes, sizeof(Overflow));
        }
      }
  }

  // Sorts what found its list full by tile. Where nothing did, overflow lists do not exist.
  void sort_overflows(const std::vector<std::vector<Overflow>>& full) {
    size_t count = 0;
    for (const auto& some : full) count += some.size();
    if (!count) return;
    overflow_begin_.assign(sizes_.size() + 1, 0);
    for (const auto& some : full)
      for (const Overflow& o : some) ++overflow_begin_[(size_t)o.tile + 1];
    for (size_t i = 0; i < sizes_.size(); ++i) overflow_begin_[i + 1] += overflow_begin_[i];
    std::vector<int64_t> next(overflow_begin_.begin(), overflow_begin_.end() - 1);
    overflows_.resize(count);
    for (const auto& some : full)
      for (const Overflow& o : some) overflows_[(size_t)next[(size_t)o.tile]++] = o.element;
  }

  // The lists of the tiles that hold pixel (x, y) of a view, the finest first. Returns their number, at most
  // 2 * kMostLevels; empty lists are left out.
  int lists_of(int64_t view, int x, int y, TileElements* out) const {
    int n = 0;
    for (const Level& level : shape_.levels) {
      const int64_t in_level = (int64_t)(y / level.size) * level.columns + x / level.size;
      const size_t tile = (size_t)((view - first_view_) * shape_.tiles + level.first_tile + in_level);
      if (!sizes_[tile]) continue;
      const TileElement* first =
          slots_.get() + (view - first_view_) * shape_.slots + level.first_slot + in_level * level.room;
      out[n++] = {first, std::min(sizes_[tile], level.room)};
      if (sizes_[tile] > level.room)
        out[n++] = {overflows_.data() + overflow_begin_[tile], overflow_begin_[tile + 1] - overflow_begin_[tile]};
    }
    return n;
  }

 private:
  const Shape& shape_;
  int64_t first_view_;
  std::vector<int64_t> sizes_;  // elements that lists were to hold
  std::unique_ptr<TileElement[]> slots_;  // list after list
  std::vector<int64_t> overflow_begin_;  // by tile; one more than there are tiles
  std::vector<TileElement> overflows_;  // by tile
};

class Drawing {
 public:
  Drawing(const ProjectedFrame& frame, const Parallel& parallel, const int64_t* values)
      : frame_(frame),
        parallel_(parallel),
        shape_(frame, values),
        share_(values[kShare]),
        shares_((frame.count + share_ - 1) / share_),
        early_z_(values[kEarlyZ] != 0),
        kernels_(current_kernels().hierarchical_tiles) {}

  // Views together, or one view in several rounds.
  void draw() {
    std::fill_n(frame_.dropped, frame_.views, 0);
    const int64_t together = std::clamp<int64_t>(
        std::min(kMostSlots / shape_.slots, kSharesTogether / std::max<int64_t>(shares_, 1)), 1, frame_.views);
    for (int64_t view = 0; view < frame_.views; view += together) {
      const int64_t views = std::min<int64_t>(together, frame_.views - view), all = views * shares_;
      int64_t first = 0;
      do {
        const int64_t count = std::min(kSharesTogether, all - first);
        draw_round(view, views, first, count);
        first += count;
      } while (first < all);
    }
  }

 private:
  // Sets up `count` shares of some views, and draws them over what earlier rounds of these views have drawn.
  void draw_round(int64_t first_view, int64_t views, int64_t first_share, int64_t count) {
    std::vector<std::vector<Record>> records((size_t)count);
    std::vector<std::vector<Overflow>> full((size_t)count);
    Pyramid pyramid(shape_, first_view, views);
    parallel_(count, [&](int64_t i) {
      Counts counts(frame_.map);
      std::vector<Record>& own = records[(size_t)i];
      set_up(frame_, share_of(frame_, share_, first_view * shares_ + first_share + i),
             [&](const Record& r) { own.push_back(r); });
      for (const Record& r : own) pyramid.store(&r, &full[(size_t)i], &counts);
      counts.add(Counter::records, (int64_t)own.size());
      counts.add(Counter::by_tiles, (int64_t)own.size());
      counts.add(Counter::bytes, (int64_t)(own.size() * sizeof(Record)));
      counts.publish(frame_.counters);
    });
    pyramid.sort_overflows(full);
    const int64_t bins_x = bin_columns(frame_.view), bins = bins_x * bin_rows(frame_.view);
    parallel_(views * bins, [&](int64_t i) {
      Counts counts(frame_.map);
      draw_bin(pyramid, first_view + i / bins, (int)(i % bins % bins_x), (int)(i % bins / bins_x), first_share > 0,
               &counts);
      counts.publish_task(frame_.counters);
    });
  }

  // The finest tiles of a bin. begun: the image holds what earlier rounds have drawn.
  void draw_bin(const Pyramid& pyramid, int64_t view, int bin_x, int bin_y, bool begun, Counts* counts) const {
    const int size = shape_.levels[0].size, pitch = pitch_of(size), width = frame_.view.width;
    int64_t pixels[kPixelsOfTile];
    for (int y = bin_y * kBin; y < std::min((bin_y + 1) * kBin, frame_.view.height); y += size)
      for (int x = bin_x * kBin; x < std::min((bin_x + 1) * kBin, width); x += size) {
        TileElements lists[2 * kMostLevels];
        const FinestTile tile = {x, y, size, lists, pyramid.lists_of(view, x, y, lists), early_z_, pixels};
        const int columns = std::min(size, width - x), rows = std::min(size, frame_.view.height - y);
        const int64_t at = (int64_t)y * width + x;
        int64_t* image = pixels_of(frame_, view) + at;
        if (tile.list_count) {
          std::fill_n(pixels, size * pitch + 8, kBackground);
          for (int j = 0; begun && j < rows; ++j) std::copy_n(image + j * width, columns, pixels + j * pitch);
          kernels_.walk_up(tile, counts);
          for (int j = 0; j < rows; ++j) std::copy_n(pixels + j * pitch, columns, image + (int64_t)j * width);
          counts->add(Counter::written, columns * rows);
        } else if (!begun) {
          for (int j = 0; j < rows; ++j) std::fill_n(image + (int64_t)j * width, columns, kBackground);
        }
        if (float* depth = frame_.depth ? view_of(frame_, view).depth + at : nullptr)
          for (int j = 0; j < rows; ++j)
            std::transform(image + (int64_t)j * width, image + (int64_t)j * width + columns, depth + (int64_t)j * width,
                           depth_of);
      }
  }

  const ProjectedFrame& frame_;
  const Parallel& parallel_;
  const Shape shape_;
  const int64_t share_, shares_;  // triangles of a share; shares of a view
  const bool early_z_;
  const HierarchicalTilesKernels& kernels_;
};

void draw(const ProjectedFrame& frame, const Parallel& parallel, const int64_t* values) {
  Drawing(frame, parallel, values).draw();
}

}  // namespace

extern const Variant hierarchical_tiles_variant;
const Variant hierarchical_tiles_variant = {
    "hierarchical_tiles", "a pyramid of tiles, a triangle at the level where it meets few, owned pixels: Merchante",
    kParameters, draw_groups<draw>, /*shades=*/false};

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri
