// The first half of the shading pass (shade.inl): runs of pixels of one triangle get weights and interpolated attributes,
// which are appended to lists of fragments. Compiled once per instruction set.
#pragma once

#include "attributes.inl"
#include "texture.inl"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

// Interpolated channels of a fragment: uv, vertex colour, normal.
enum { kUv = 0, kColor = 2, kNormal = 5, kChannels = 8 };

// Where a triangle's normals come from.
enum class Normals { kZero, kFace, kSmooth };

// A record over the whole image. e_k at pixel (x, y) is origin[k] + step_x[k] * x + step_y[k] * y: integers below 2^53,
// so float64 is exact.
struct Planes {
  double origin[3], step_x[3], step_y[3];
  double least[3];  // the record covers the samples where e_k >= least[k] for all k
  double share[3];  // about 1 / (area * w[k]); where all w are equal, about 1 / area
};

// A triangle that is ready to be shaded.
struct Shaded {
  int64_t key;  // view << 32 | triangle; -1: none
  bool drawn;  // false: no record covers a pixel
  bool clipped;
  const float* base;  // base colour of the material
  Look look;  // without what the surface has no data for
  Normals normals;
  float facing;  // -1: the normal is turned round; else 1
  float value[kChannels][3];  // at the corners that barycentric 0, 1, 2 belong to
  float face[3];
  ParentOf<1> parent;  // if not clipped
  Planes planes;  // if not clipped
};

constexpr int kFragments = 1024;  // after which a list is shaded
constexpr int kFragmentRoom = kFragments + kBin + 16;  // a row of a block more, and what vectors write past the end
constexpr int kShadedBits = 7;

// Consecutive fragments of one material.
struct Segment {
  int begin;
  const float* base;
  Look look;
};

struct ShadeScratch {
  alignas(64) float channel[kChannels][kFragmentRoom];
  int32_t at[kFragmentRoom];  // place in the image of samples, counted from the block's first sample
  Segment segment[kFragmentRoom];
  int count, segments;
  float linear[3][kBin];  // of a row of samples, where several make a pixel
  bool covered[kBin];
#if BIGTRI_SIMD >= 512
  CodeTable codes;
#endif
  // The triangles that were met last, each at the place that its index's lowest bits name.
  Shaded shaded[1 << kShadedBits];
  int64_t clipped_key;  // what `clipped` holds
  Parent clipped;
  Planes clipped_planes[kMaxSubTriangles];
};
static_assert(sizeof(ShadeScratch) <= kShadeScratchBytes, "scratch");

void shade_begin(const ShadeJob& job, void* memory) {
  ShadeScratch* s = (ShadeScratch*)memory;
#if BIGTRI_SIMD >= 512
  fill_code_table(job.decoded8, &s->codes);
#endif
  for (Shaded& shaded : s->shaded) shaded.key = -1;
  s->clipped_key = -1;
  s->count = s->segments = 0;
}

constexpr bool kFastWeights = !kTestsRows && kAttributeRule == AttributeRule::kFloat64;

template <int kRecords>
void set_planes(const ParentOf<kRecords>& parent, int record, Planes* out) {
  const Primitive& p = parent.primitive[record];
  for (int k = 0; k < 3; ++k) {
    const Edge edge = edge_of(p.x, p.y, k);
    out->origin[k] = edge_at(p, k, 0, 0);
    out->step_x[k] = -(double)kSubpixel * edge.dy;
    out->step_y[k] = (double)kSubpixel * edge.dx;
    out->least[k] = -(double)edge_bias(edge);
    out->share[k] = 1.0 / (parent.affine ? (double)p.area : (double)p.area * parent.w[record][k]);
  }
}

// The edge values of eight pixels of row y from x on.
BIGTRI_INLINE void edges_of_eight(const Planes& of, int y, int x, f64x8 e[3]) {
  const f64x8 column = load<f64x8>(kLaneDouble) + (double)x;
  for (int k = 0; k < 3; ++k) e[k] = (of.origin[k] + of.step_y[k] * y) + column * of.step_x[k];
}

// Rounds what `barycentrics` gives to float32, for n pixels with edge values e; the others' weights mean nothing.
//
// It multiplies by reciprocals where barycentrics divides. With edge values that are not negative, as weights of slots
// never are (cut_weight), nothing cancels, and rounding 31 times at most, here and there together and an end of the
// interval included, moves a result by less than 2^-48 of it.
// Rounding to float32 is monotone, so where both ends of an interval around the result go to the same float32, that of
// barycentrics goes there too. Where they do not, in one of millions of pixels, it divides.
template <int kRecords>
BIGTRI_INLINE void weigh_quickly(const ParentOf<kRecords>& parent, int record, const Planes& planes, const f64x8 e[3],
                                 int n, f32x8 weight[3]) {
  f64x8 b[3];
  for (int k = 0; k < 3; ++k) b[k] = e[k] * planes.share[k];
  if (parent.clipped) {
    const double (*t)[3] = parent.weights[record];
    const f64x8 u0 = b[0], u1 = b[1], u2 = b[2];
    for (int m = 0; m < 3; ++m) b[m] = (u0 * t[0][m] + u1 * t[1][m]) + u2 * t[2][m];
  }
  if (!parent.affine) {
    const f64x8 inverse = 1.0 / ((b[0] + b[1]) + b[2]);
    for (int k = 0; k < 3; ++k) b[k] = b[k] * inverse;
  }
  constexpr double kError = 1.0 / (1ll << 48);
  f32x8 upper[3];
  for (int k = 0; k < 3; ++k) {
    weight[k] = to_float(b[k] * (1.0 - kError));
    upper[k] = to_float(b[k] * (1.0 + kError));
  }
  const i32x8 sure = (weight[0] == upper[0]) & (weight[1] == upper[1]) & (weight[2] == upper[2]);
  const uint32_t doubtful = ~sign_mask(sure) | sign_mask(e[0]) | sign_mask(e[1]) | sign_mask(e[2]);
  if ((doubtful & ((1u << n) - 1)) == 0) return;
  barycentrics(parent, record, e, b);
  for (int k = 0; k < 3; ++k) weight[k] = to_float(b[k]);
}

// Sets the attributes at the corners that the weights belong to: corner[k] of the triangle.
BIGTRI_INLINE void load_corners(const Surface& f, const int32_t* vertex, const int corner[3], Shaded* out) {
  const bool textured = out->look.texture >= 0, colored = out->look.bits & kLookVertexColors,
             smooth = out->normals == Normals::kSmooth;
  for (int k = 0; k < 3; ++k) {
    const int64_t v = vertex[corner[k]];
    if (textured)
      for (int c = 0; c < 2; ++c) out->value[kUv + c][k] = f.uvs[2 * v + c];
    if (colored)
      for (int c = 0; c < 3; ++c) out->value[kColor + c][k] = f.colors[3 * v + c];
    if (smooth)
      for (int c = 0; c < 3; ++c) out->value[kNormal + c][k] = f.normals[3 * v + c];
  }
}

void prepare(const ShadeJob& job, int64_t view, int64_t triangle, ShadeScratch* s, Shaded* out) {
  const Surface& f = job.surface;
  const int32_t* vertex = job.triangles + 3 * triangle;
  const int32_t material = f.material[triangle];
  out->key = view << 32 | triangle;
  out->base = f.base_colors + 3 * material;
  out->look = f.looks[material];
  if (!f.uvs) out->look.texture = -1;
  if (!f.colors) out->look.bits &= ~kLookVertexColors;
  const bool smooth = f.normals && (!f.face_normals || (out->look.bits & kLookSmooth));
  out->normals = smooth ? Normals::kSmooth : f.face_normals ? Normals::kFace : Normals::kZero;
  if (out->normals == Normals::kFace)
    for (int c = 0; c < 3; ++c) out->face[c] = f.face_normals[3 * triangle + c];

  const Viewport whole = {job.width, job.height, 0, 0, job.width, job.height, kCullNone};
  float v[3][4];
  Vertex projected[3];
  for (int k = 0; k < 3; ++k) {
    for (int i = 0; i < 4; ++i) v[k][i] = job.positions[view * job.position_view + 4 * (int64_t)vertex[k] + i];
    projected[k] = project_vertex(v[k], job.width, job.height);
  }
  const bool turned = f.two_sided && (out->look.bits & kLookTwoSided) && is_back(v[0], v[1], v[2]);
  out->facing = turned ? -1.0f : 1.0f;
  const Fate fate = fate_of(projected[0].flags, projected[1].flags, projected[2].flags);
  out->clipped = fate == Fate::kClip;
  if (out->clipped) {
    expand_parent(v, projected, whole, &s->clipped);
    s->clipped_key = out->key;
    out->drawn = s->clipped.count > 0;
    if constexpr (kFastWeights)
      for (int i = 0; i < s->clipped.count; ++i) set_planes(s->clipped, i, &s->clipped_planes[i]);
    const int corner[3] = {s->clipped.first, (s->clipped.first + 1) % 3, (s->clipped.first + 2) % 3};
    if (out->drawn) load_corners(f, vertex, corner, out);
    return;
  }
  out->drawn = fate == Fate::kWhole && expand_whole(v, projected, whole, &out->parent);
  if (!out->drawn) return;
  const Primitive& p = out->parent.primitive[0];
  load_corners(f, vertex, p.order, out);
  if constexpr (kFastWeights) set_planes(out->parent, 0, &out->planes);
}

// Appends n fragments of a triangle, whose weights these are.
BIGTRI_INLINE void append(const Shaded& t, const f32x8 weight[3], int at, int n, ShadeScratch* s) {
  const int count = s->count;
  const auto put = [&](int c) __attribute__((always_inline)) {
    store(s->channel[c] + count, interpolate(weight, t.value[c][0], t.value[c][1], t.value[c][2]));
  };
  if (t.look.texture >= 0)
    for (int c = kUv; c < kUv + 2; ++c) put(c);
  if (t.look.bits & kLookVertexColors)
    for (int c = kColor; c < kColor + 3; ++c) put(c);
  for (int c = 0; c < 3; ++c) {
    f32x8 v = splat<f32x8>(t.normals == Normals::kFace ? t.face[c] : 0.0f);
    if (t.normals == Normals::kSmooth)
      v = interpolate(weight, t.value[kNormal + c][0], t.value[kNormal + c][1], t.value[kNormal + c][2]);
    store(s->channel[kNormal + c] + count, v * t.facing);
  }
  store(s->at + count, at + load<i32x8>(kLaneInt));
  s->count += n;
}

// The clipped triangle's first record that covers pixel (x, y), -1 if none does; how many of n <= 8 pixels from there on it
// covers first, or none does; and the edge values, if there is a record.
BIGTRI_INLINE int first_record(const ShadeScratch& s, int y, int x, int n, int* same, f64x8 e[3]) {
  uint32_t left = (1u << n) - 1;  // bit i: no record so far covers pixel x + i
  for (int record = 0; record < s.clipped.count; ++record) {
    const Planes& planes = s.clipped_planes[record];
    edges_of_eight(planes, y, x, e);
    uint32_t outside = 0;
    for (int k = 0; k < 3; ++k) outside |= sign_mask(e[k] - planes.least[k]);
    if (left & ~outside & 1) {
      *same = __builtin_ctz(~left | outside | 1u << n);
      return record;
    }
    left &= outside;
  }
  *same = __builtin_ctz(~left);
  return -1;
}

// The weights of pixels of row y from x on, all of triangle t: of as many of n <= 8 as one record covers, which it returns;
// 0 where no record covers them. row: one of the row's, to start with an empty one.
BIGTRI_INLINE int weigh(const ShadeJob& job, const Shaded& t, const ShadeScratch& s, int y, int x, int n,
                        RowRecord* row, f32x8 weight[3]) {
  for (int k = 0; k < 3; ++k) weight[k] = splat<f32x8>(0.0f);
  if constexpr (kFastWeights) {
    f64x8 e[3];
    if (t.clipped) {
      const int record = first_record(s, y, x, n, &n, e);
      if (record >= 0) weigh_quickly(s.clipped, record, s.clipped_planes[record], e, n, weight);
    } else {
      edges_of_eight(t.planes, y, x, e);
      weigh_quickly(t.parent, 0, t.planes, e, n, weight);
    }
    return n;
  }
  bool covered[8];
  if (t.clipped) {
    const int record = covering_record(s.clipped, x, y);
    int same = 1;
    while (same < n && covering_record(s.clipped, x + same, y) == record) ++same;
    if (record < 0) return same;
    if (record != row->record) begin_edges(s.clipped, record, y, row);
    weigh_eight(job.width, job.height, s.clipped, *row, x, same, weight, covered);
    return same;
  }
  if (row->record < 0) begin_edges(t.parent, 0, y, row);
  weigh_eight(job.width, job.height, t.parent, *row, x, n, weight, covered);
  return n;
}

// The pixels [x, x + n) of row y, all of one triangle; `at` is the place of the first.
void append_run(const ShadeJob& job, Shaded* t, int y, int x, int n, int at, ShadeScratch* s) {
  if (s->segments == 0 || s->segment[s->segments - 1].base != t->base)
    s->segment[s->segments++] = {s->count, t->base, t->look};
  // Another clipped triangle may have been set up since.
  if (t->clipped && s->clipped_key != t->key) prepare(job, t->key >> 32, t->key & 0xffffffff, s, t);
  RowRecord row;
  f32x8 weight[3];
  for (int i = 0, some; i < n; i += some) {
    some = weigh(job, *t, *s, y, x + i, min_of(8, n - i), &row, weight);
    append(*t, weight, at + i, some, s);
  }
}

// Bit i: the run of one triangle that sample i of n <= 64 lies in ends there.
BIGTRI_INLINE uint64_t run_ends(const int64_t* packed, int n) {
  uint64_t ends = 1ull << (n - 1);
  const auto compare = [&](int i) __attribute__((always_inline)) {
    ends |= (uint64_t)lower_differ(load<i64x8>(packed + i), load<i64x8>(packed + i + 1)) << i;
  };
  if (n < 9) {
    for (int i = 0; i + 1 < n; ++i) ends |= (uint64_t)((uint32_t)packed[i] != (uint32_t)packed[i + 1]) << i;
    return ends;
  }
  for (int i = 0; i < n - 9; i += 8) compare(i);
  compare(n - 9);
  return ends;
}

// Appends the fragments of n <= 64 samples of a row. empty(i, n): samples [i, i + n) have none.
template <class Empty>
BIGTRI_INLINE void append_row(const ShadeJob& job, int64_t view, const int64_t* packed, int y, int x, int n, int at,
                              ShadeScratch* s, const Empty& empty) {
  int i = 0;
  for (uint64_t ends = run_ends(packed, n); ends; ends &= ends - 1) {
    const int end = __builtin_ctzll(ends) + 1;
    const uint32_t triangle = (uint32_t)packed[i];
    // The background names none of the triangles: kBackground ends in 32 bits that are set.
    Shaded* t = nullptr;
    if (triangle < job.triangle_count) {
      t = s->shaded + (triangle & ((1 << kShadedBits) - 1));
      if (t->key != (view << 32 | (int64_t)triangle)) prepare(job, view, triangle, s, t);
    }
    if (t && t->drawn)
      append_run(job, t, y, x + i, end - i, at + i, s);
    else
      empty(i, end - i);
    i = end;
  }
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri
