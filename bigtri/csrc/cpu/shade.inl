// The kernel of the shading pass; docs/numerics.md 18. It finishes the pixels of a block of a visibility buffer: weights,
// attributes, texture, vertex colour, light, sRGB. Called by shade.cpp for every block of an image, and by bin_owned.inl
// for each bin that has been drawn. Compiled once per instruction set.
//
// Triangles that cover a few pixels each leave most of a vector empty, so the work is cut in two. The first half goes
// along runs of pixels of one triangle; the attributes of a run are appended to lists, the next run's right behind them.
// The second half takes sixteen fragments of a list at a time, whatever triangles they are of.
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
  // The triangles that were met last, each at the place that its index's lowest bits name.
  Shaded shaded[1 << kShadedBits];
  int64_t clipped_key;  // what `clipped` holds
  Parent clipped;
  Planes clipped_planes[kMaxSubTriangles];
};
static_assert(sizeof(ShadeScratch) <= kShadeScratchBytes, "scratch");

void shade_begin(void* memory) {
  ShadeScratch* s = (ShadeScratch*)memory;
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
// never are (cut_weight), nothing cancels, and rounding 30 times at most, here and there together, moves a result by less
// than 2^-48 of it.
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
  f32x8 upper[3];
  for (int k = 0; k < 3; ++k) {
    const f64x8 error = b[k] * (1.0 / (1ll << 48));
    weight[k] = to_float(b[k] - error);
    upper[k] = to_float(b[k] + error);
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

// The pixels [x, x + n) of row y, all of one triangle; `at` is the place of the first.
void append_run(const ShadeJob& job, Shaded* t, int y, int x, int n, int at, ShadeScratch* s) {
  if (s->segments == 0 || s->segment[s->segments - 1].base != t->base)
    s->segment[s->segments++] = {s->count, t->base, t->look};
  // Another clipped triangle may have been set up since.
  if (t->clipped && s->clipped_key != t->key) prepare(job, t->key >> 32, t->key & 0xffffffff, s, t);
  f32x8 weight[3];
  f64x8 e[3];
  bool covered[8];
  RowRecord row;
  if constexpr (!kFastWeights)
    if (!t->clipped) begin_edges(t->parent, 0, y, &row);
  for (int i = 0, some; i < n; i += some) {
    some = min_of(8, n - i);
    if (t->clipped) {
      for (int k = 0; k < 3; ++k) weight[k] = splat<f32x8>(0.0f);
      if constexpr (kFastWeights) {
        const int record = first_record(*s, y, x + i, some, &some, e);
        if (record >= 0) weigh_quickly(s->clipped, record, s->clipped_planes[record], e, some, weight);
      } else {
        const int record = covering_record(s->clipped, x + i, y), most = some;
        for (some = 1; some < most && covering_record(s->clipped, x + i + some, y) == record;) ++some;
        if (record >= 0 && record != row.record) begin_edges(s->clipped, record, y, &row);
        if (record >= 0) weigh_eight(job.width, job.height, s->clipped, row, x + i, some, weight, covered);
      }
    } else if constexpr (kFastWeights) {
      edges_of_eight(t->planes, y, x + i, e);
      weigh_quickly(t->parent, 0, t->planes, e, some, weight);
    } else {
      weigh_eight(job.width, job.height, t->parent, row, x + i, some, weight, covered);
    }
    append(*t, weight, at + i, some, s);
  }
}

// Appends the fragments of n samples of a row. empty(i, n): samples [i, i + n) have none.
template <class Empty>
BIGTRI_INLINE void append_row(const ShadeJob& job, int64_t view, const int64_t* packed, int y, int x, int n, int at,
                              ShadeScratch* s, const Empty& empty) {
  for (int i = 0, end; i < n; i = end) {
    const uint32_t triangle = (uint32_t)packed[i];
    for (end = i + 1; end < n && (uint32_t)packed[end] == triangle;) ++end;
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
  }
}

// Fragments are shaded this many at a time, in steps that each go through all of them: what one step stores number by
// number, the next loads by vectors, which a processor can do fast only when the stores are done.
constexpr int kTogether = kLookups;

// Multiplies the albedo of n fragments by a texture. u, v: their coordinates.
template <class Texels>
BIGTRI_INLINE void multiply_texture(const Texels& texels, const Texture& t, const Look& look, const float* u,
                                    const float* v, int n, float albedo[3][kTogether]) {
  const Wrap wrap = look.bits & kLookClamp ? Wrap::kClamp : Wrap::kRepeat;
  const Filter filter = look.bits & kLookNearest ? Filter::kNearest : Filter::kBilinear;
  float texel[kTogether][4];
  if (are_numbered(t.height, t.width, 3)) {
    Lookups at;
    find_texels<3>(t.height, t.width, u, v, n, filter, wrap, &at);
    blend_texels<3>(texels, (int64_t)t.height * t.width * 3, at, n, filter,
                    [&](int i, const f32x4& value) { store(texel[i], value); });
  } else {
    for (int i = 0; i < n; ++i) sample(texels, t.height, t.width, 3, u[i], v[i], filter, wrap, texel[i]);
  }
  for (int i = 0; i < n; i += 16) {
    f32x16 channel[3];
    load_triples(texel[i], channel);
    for (int c = 0; c < 3; ++c) store(albedo[c] + i, load<f32x16>(albedo[c] + i) * channel[c]);
  }
}

void apply_texture(const ShadeJob& job, const Look& look, const float* u, const float* v, int n,
                   float albedo[3][kTogether]) {
  const Texture& t = job.surface.textures[look.texture];
  if (t.kind == Texels::kCodes8)
    multiply_texture(CodedTexels<uint8_t>{(const uint8_t*)t.texels, job.decoded8}, t, look, u, v, n, albedo);
  else if (t.kind == Texels::kCodes16)
    multiply_texture(CodedTexels<uint16_t>{(const uint16_t*)t.texels, job.decoded16}, t, look, u, v, n, albedo);
  else
    multiply_texture((const float*)t.texels, t, look, u, v, n, albedo);
}

// Writes n triples to their places in an image of three floats a sample, if there is one.
BIGTRI_INLINE void scatter(float* image, const int32_t* at, int n, const float of[3][kTogether]) {
  for (int i = 0; image && i < n; ++i)
    for (int c = 0; c < 3; ++c) image[3 * (int64_t)at[i] + c] = of[c][i];
}

// Writes the sRGB codes of n colours to their pixels. linear: the colours, within the table's steps.
template <int kChannels>
BIGTRI_INLINE void encode_pixels(const SrgbSteps& table, uint8_t* image, const int32_t* at, int n,
                                 const float linear[3][kTogether]) {
  for (int i = 0; i < n; ++i) {
    uint8_t* pixel = image + kChannels * (int64_t)at[i];
    for (int c = 0; c < 3; ++c) pixel[c] = encode_step(linear[c][i], table);
    if (kChannels == 4) pixel[3] = 255;
  }
}

// Where the fragments of a block, or of a row of samples, go.
struct Targets {
  uint8_t* image;  // null where several samples make a pixel
  float *albedo, *normals, *linear;  // or null
};

// Shades fragments [i, i + n) of the lists, at most kTogether of one material.
void shade_together(const ShadeJob& job, const Targets& to, const Segment& segment, int i, int n,
                    const ShadeScratch& s) {
  const Surface& f = job.surface;
  const int32_t* at = s.at + i;
  float albedo[3][kTogether], normal[3][kTogether], linear[3][kTogether], encoded[3][kTogether];
  for (int k = 0; k < n; k += 16)
    for (int c = 0; c < 3; ++c) store(albedo[c] + k, splat<f32x16>(segment.base[c]));
  if (segment.look.texture >= 0)
    apply_texture(job, segment.look, s.channel[kUv] + i, s.channel[kUv + 1] + i, n, albedo);
  for (int k = 0; k < n; k += 16) {
    f32x16 base[3], direction[3], lit[3];
    for (int c = 0; c < 3; ++c) {
      base[c] = load<f32x16>(albedo[c] + k);
      if (segment.look.bits & kLookVertexColors) base[c] = base[c] * load<f32x16>(s.channel[kColor + c] + i + k);
      direction[c] = load<f32x16>(s.channel[kNormal + c] + i + k);
    }
    lambert(direction, base, f.ambient, f.light_directions, f.light_colors, f.lights, lit);
    for (int c = 0; c < 3; ++c) {
      store(albedo[c] + k, base[c]);
      store(normal[c] + k, direction[c]);
      store(linear[c] + k, lit[c]);
      store(encoded[c] + k, within_steps(lit[c]));
    }
  }
  scatter(to.albedo, at, n, albedo);
  scatter(to.normals, at, n, normal);
  scatter(to.linear, at, n, linear);
  if (to.image && job.channels == 4)
    encode_pixels<4>(*job.srgb, to.image, at, n, encoded);
  else if (to.image)
    encode_pixels<3>(*job.srgb, to.image, at, n, encoded);
}

// Shades all fragments of the lists, and empties them.
void shade_fragments(const ShadeJob& job, const Targets& to, ShadeScratch* s) {
  for (int k = 0; k < s->segments; ++k) {
    const Segment& segment = s->segment[k];
    const int end = k + 1 < s->segments ? s->segment[k + 1].begin : s->count;
    for (int i = segment.begin; i < end; i += kTogether)
      shade_together(job, to, segment, i, min_of(kTogether, end - i), *s);
  }
  s->count = s->segments = 0;
}

// Fills n samples of an image of three floats a sample with a colour, if there is an image.
BIGTRI_INLINE void fill(float* to, int n, const float color[3]) {
  for (int i = 0; to && i < 3 * n; ++i) to[i] = color[i % 3];
}

// kBin pixels of one colour, to copy from.
struct Plain {
  const uint8_t* color = nullptr;
  alignas(64) uint8_t bytes[4 * kBin];
};

BIGTRI_INLINE void make_plain(const uint8_t color[4], int channels, Plain* plain) {
  if (plain->color && __builtin_memcmp(plain->color, color, 4) == 0) return;
  plain->color = color;
  // Of three bytes a pixel the fourth is the next pixel's.
  for (int i = 0; i < 8; ++i) __builtin_memcpy(plain->bytes + channels * i, color, 4);
  for (int i = 8 * channels; i < channels * kBin; i *= 2) __builtin_memcpy(plain->bytes + i, plain->bytes, (size_t)i);
}

// n pixels of one colour. Around the caches where the pictures do not fit them.
void fill_pixels(const ShadeJob& job, uint8_t* to, int n, const Plain& plain) {
  // Whole cache lines, of three channels and of four.
  const int piece = kBin * job.channels, bytes = n * job.channels;
  int i = 0;
  if (job.streams && ((uintptr_t)to & 63) == 0)
    for (; i + piece <= bytes; i += piece)
      for (int k = 0; k < piece; k += 64)
        stream((int64_t*)(to + i + k), load<i64x8>((const int64_t*)(plain.bytes + k)));
  for (; i + piece <= bytes; i += piece)
    for (int k = 0; k < piece; k += 64) __builtin_memcpy(to + i + k, plain.bytes + k, 64);
  __builtin_memcpy(to + i, plain.bytes, (size_t)(bytes - i));
}

// Fills rows [y, y + height) of samples of the outputs that have a value for each sample.
void fill_samples(const ShadeJob& job, int64_t view, int x, int y, int width, int height) {
  const float zero[3] = {0.0f, 0.0f, 0.0f};
  for (int j = y; j < y + height; ++j) {
    const int64_t first = 3 * ((view * job.height + j) * job.width + x);
    float background[3];
    background_at(job.surface, j, job.height, job.channels, background);
    if (job.albedo) fill(job.albedo + first, width, zero);
    if (job.normals) fill(job.normals + first, width, zero);
    if (job.linear) fill(job.linear + first, width, background);
  }
}

// Where a picture's row of pixels begins.
BIGTRI_INLINE uint8_t* pixel_at(const ShadeJob& job, int64_t view, int x, int y) {
  return job.image + job.channels * ((view * (job.height / job.samples) + y) * (job.width / job.samples) + x);
}

void shade_background(const ShadeJob& job, int64_t view, int x, int y, int width, int height) {
  const int n = job.samples;
  if (job.albedo || job.normals || job.linear) fill_samples(job, view, x, y, width, height);
  Plain plain;
  for (int row = y / n; row < (y + height) / n; ++row) {
    make_plain(job.background + 4 * row, job.channels, &plain);
    fill_pixels(job, pixel_at(job, view, x / n, row), width / n, plain);
  }
}

// A sample a pixel: fragments, and the background where there are none.
void shade_pixels(const ShadeJob& job, const ShadeBlock& b, ShadeScratch* s) {
  if (job.albedo || job.normals || job.linear) fill_samples(job, b.view, b.x, b.y, b.width, b.height);
  const int64_t first = (b.view * job.height + b.y) * job.width + b.x;
  const auto image = [&](float* of) { return of ? of + 3 * first : nullptr; };
  const Targets to = {job.image + job.channels * first, image(job.albedo), image(job.normals), image(job.linear)};
  Plain plain;
  for (int j = 0; j < b.height; ++j) {
    uint8_t* row = to.image + (int64_t)job.channels * j * job.width;
    append_row(job, b.view, b.packed + j * b.pitch, b.y + j, b.x, b.width, j * job.width, s, [&](int i, int n) {
      make_plain(job.background + 4 * (b.y + j), job.channels, &plain);
      fill_pixels(job, row + job.channels * i, n, plain);
    });
    if (s->count > kFragments) shade_fragments(job, to, s);
  }
  shade_fragments(job, to, s);
}

// Several samples a pixel: rows of samples are shaded one by one and added up.
void shade_samples(const ShadeJob& job, const ShadeBlock& b, ShadeScratch* s) {
  const int n = job.samples;
  if (job.albedo || job.normals || job.linear) fill_samples(job, b.view, b.x, b.y, b.width, b.height);
  for (int row = 0; row < b.height; row += n) {
    float total[3][kBin] = {};
    int covered[kBin] = {};
    for (int j = row; j < row + n; ++j) {
      float background[3];
      background_at(job.surface, b.y + j, job.height, job.channels, background);
      // A pixel may be wider than a block.
      for (int x = 0; x < b.width; x += kBin) {
        const int some = min_of(kBin, b.width - x);
        __builtin_memset(s->covered, true, (size_t)some);
        append_row(job, b.view, b.packed + j * b.pitch + x, b.y + j, b.x + x, some, 0, s,
                   [&](int i, int n) { __builtin_memset(s->covered + i, false, (size_t)n); });
        const int64_t first = 3 * ((b.view * job.height + b.y + j) * job.width + b.x + x);
        const auto image = [&](float* of) { return of ? of + first : nullptr; };
        float linear[3 * kBin];
        for (int i = 0; i < some; ++i)
          for (int c = 0; c < 3; ++c) linear[3 * i + c] = background[c];
        shade_fragments(job, {nullptr, image(job.albedo), image(job.normals), linear}, s);
        if (job.linear) __builtin_memcpy(job.linear + first, linear, (size_t)(3 * some) * sizeof(float));
        for (int i = 0; i < some; ++i) {
          const int pixel = (x + i) / n;
          for (int c = 0; c < 3; ++c) total[c][pixel] = total[c][pixel] + linear[3 * i + c];
          covered[pixel] += s->covered[i];
        }
      }
    }
    for (int i = 0; i < b.width / n; ++i) {
      const float mean[3] = {total[0][i], total[1][i], total[2][i]};
      store_mean(mean, covered[i], n * n, job.channels, *job.srgb, pixel_at(job, b.view, b.x / n + i, (b.y + row) / n));
    }
  }
}

void shade_block(const ShadeJob& job, const ShadeBlock& block, void* memory) {
  ShadeScratch* s = (ShadeScratch*)memory;
  if (job.samples == 1)
    shade_pixels(job, block, s);
  else
    shade_samples(job, block, s);
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri
