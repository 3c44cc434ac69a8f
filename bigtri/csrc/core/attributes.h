// Barycentrics and interpolation of attributes; docs/numerics.md 9. The attribute pass uses them at each pixel, with
// the record that resolve found. Mirrors bigtri/reference/attributes.py.
#pragma once

#include "resolve.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {

// e_k at the centre of pixel (x, y), unbiased. float64 holds it exactly, since |e| < 2^49 (edge_value).
BIGTRI_HD double edge_at(const Primitive& p, int k, int32_t x, int32_t y) {
  return (double)edge_value(edge_of(p.x, p.y, k), pixel_centre(x), pixel_centre(y));
}

constexpr AttributeRule kAttributeRule = Rung::kAttributes;
constexpr bool kUnsnappedWeights = kAttributeRule == AttributeRule::kUnsnapped;
constexpr bool kFloatWeights =
    kAttributeRule == AttributeRule::kFloat32 || kAttributeRule == AttributeRule::kReciprocal;

// The divisor v of several quotients, of the kind of `like`.
template <class D>
BIGTRI_HD const D& divisor_like(const D& v, double) {
  return v;
}
BIGTRI_HD Divisor divisor_like(double v, const Divisor&) { return divisor(v); }

// Brings b to a sum of 1.
template <class D, class By>
BIGTRI_HD void divide_by_sum(const By& like, D b[3]) {
  const D total = (b[0] + b[1]) + b[2];
  const auto& sum = divisor_like(total, like);
  for (int k = 0; k < 3; ++k) b[k] = quotient(b[k], sum);
}

// Barycentrics b of a record that is not clipped, from the edge values e, not yet rounded to float32. They are the
// weights of its vertices. D is double or a vector of doubles; By, a double or what `quotient` divides D by alike.
template <class D, class By>
BIGTRI_HD void whole_barycentrics(const By& area, const By w[3], bool affine, const D e[3], D b[3]) {
  for (int k = 0; k < 3; ++k) b[k] = quotient(e[k], area);
  if (affine || kAttributeRule == AttributeRule::kAffine) return;
  for (int k = 0; k < 3; ++k) b[k] = quotient(b[k], w[k]);
  divide_by_sum(area, b);
}

// The same of a record that has been clipped: they are the weights of the slots, in their order. w: of the record's
// vertices, which are the rows of t, over the slots.
template <class D, class By>
BIGTRI_HD void clipped_barycentrics(const By& area, const By w[3], const double t[3][3], const D e[3], D b[3]) {
  D u[3];
  for (int k = 0; k < 3; ++k) u[k] = quotient(e[k], area);
  if constexpr (kAttributeRule == AttributeRule::kAffine) {
    double share[3][3];
    for (int k = 0; k < 3; ++k)
      for (int m = 0; m < 3; ++m) share[k][m] = t[k][m] / ((t[k][0] + t[k][1]) + t[k][2]);
    for (int m = 0; m < 3; ++m) b[m] = (u[0] * share[0][m] + u[1] * share[1][m]) + u[2] * share[2][m];
    return;
  }
  for (int k = 0; k < 3; ++k) u[k] = quotient(u[k], w[k]);
  for (int m = 0; m < 3; ++m) b[m] = (u[0] * t[0][m] + u[1] * t[1][m]) + u[2] * t[2][m];
  divide_by_sum(area, b);
}

// Barycentrics b from the edge values e, not yet rounded to float32. They are the weights of the record's vertices if
// the parent is not clipped, else of the slots, in that order. D is double or a vector of doubles.
template <int kRecords, class D>
BIGTRI_HD void barycentrics(const ParentOf<kRecords>& parent, int record, const D e[3], D b[3]) {
  const double area = (double)parent.primitive[record].area;
  if (parent.clipped)
    clipped_barycentrics(area, parent.w[record], parent.weights[record], e, b);
  else
    whole_barycentrics(area, parent.w[record], parent.affine, e, b);
}

// u, negated if the triangle is turned the other way, and 0 where the pixel lies beyond its side.
BIGTRI_HD double inner_part(double u, double turn) {
  const double towards = turn < 0 ? -u : u;
  return towards > 0 ? towards : 0.0;
}
// v / sum, or 0 where there is none: all vertices are seen on one line with the pixel's centre.
BIGTRI_HD double share_of(double v, double sum) { return sum == 0 ? 0.0 : v / sum; }

// The same as barycentrics, of a triangle's vertices v as they were given, in the order of the weights. right, up: the
// pixel's centre in normalized device coordinates. Seen from there, a point (x, y, w) of the triangle is the pixel's where
// both a and c are 0.
template <class D>
BIGTRI_HD void unsnapped_weights(const float v[3][4], const D& right, double up, D b[3]) {
  D a[3];
  double c[3];
  for (int k = 0; k < 3; ++k) {
    a[k] = (double)v[k][0] - right * (double)v[k][3];
    c[k] = (double)v[k][1] - up * (double)v[k][3];
  }
  const D u0 = a[1] * c[2] - a[2] * c[1], u1 = a[2] * c[0] - a[0] * c[2], u2 = a[0] * c[1] - a[1] * c[0];
  const D turn = (u0 + u1) + u2;
  const D v0 = inner_part(u0, turn), v1 = inner_part(u1, turn), v2 = inner_part(u2, turn);
  const D sum = (v0 + v1) + v2;
  b[0] = share_of(v0, sum);
  b[1] = share_of(v1, sum);
  b[2] = share_of(v2, sum);
}
template <int kRecords, class D>
BIGTRI_HD void unsnapped_barycentrics(const ParentOf<kRecords>& parent, int record, const D& right, double up, D b[3]) {
  float v[3][4];
  for (int k = 0; k < 3; ++k)
    for (int i = 0; i < 4; ++i) v[k][i] = parent.given[corner_of(parent, record, k)][i];
  unsnapped_weights(v, right, up, b);
}

// Normalized device coordinates of the centre of column x, or of row y counted from below, of so many. place: x, or
// several of it.
template <class D>
BIGTRI_HD D device_coordinate(const D& place, double size) {
  return (place * 2.0 + (1.0 - size)) / size;
}

// 1 / v for positive v, specified down to its bits: an integer start and two Newton steps.
BIGTRI_HD float reciprocal(float v) {
  const float start = bits_float(0x7ef311c7u - float_bits(v));  // the exponent negated, and a line for the mantissa
  const float once = start * (2.0f - v * start);
  return once * (2.0f - v * once);
}

// v / by in float32, by the rung's rule. F and B are float, or vectors of it.
template <class F, class B>
BIGTRI_HD F float_over(const F& v, const B& by) {
  if constexpr (kAttributeRule == AttributeRule::kReciprocal)
    return v * reciprocal(by);
  else
    return v / by;
}

// The same as whole_barycentrics, in float32: what is read is rounded to that first, as e is. F is float, or a vector of
// it.
template <class F>
BIGTRI_HD void whole_float_barycentrics(float area, const double w[3], bool affine, const F e[3], F b[3]) {
  for (int k = 0; k < 3; ++k) b[k] = float_over(e[k], area);
  if (affine) return;
  for (int k = 0; k < 3; ++k) b[k] = float_over(b[k], (float)w[k]);
  const F sum = (b[0] + b[1]) + b[2];
  for (int k = 0; k < 3; ++k) b[k] = float_over(b[k], sum);
}

// The same as clipped_barycentrics, in float32.
template <class F>
BIGTRI_HD void clipped_float_barycentrics(float area, const double w[3], const double t[3][3], const F e[3], F b[3]) {
  F u[3];
  for (int k = 0; k < 3; ++k) u[k] = float_over(float_over(e[k], area), (float)w[k]);
  for (int m = 0; m < 3; ++m) b[m] = (u[0] * (float)t[0][m] + u[1] * (float)t[1][m]) + u[2] * (float)t[2][m];
  const F sum = (b[0] + b[1]) + b[2];
  for (int m = 0; m < 3; ++m) b[m] = float_over(b[m], sum);
}

// The same as barycentrics, in float32.
template <int kRecords, class F>
BIGTRI_HD void float_barycentrics(const ParentOf<kRecords>& parent, int record, const F e[3], F b[3]) {
  const float area = (float)parent.primitive[record].area;
  if (parent.clipped)
    clipped_float_barycentrics(area, parent.w[record], parent.weights[record], e, b);
  else
    whole_float_barycentrics(area, parent.w[record], parent.affine, e, b);
}

// One attribute channel, in float32. a0, a1, a2: its values at the corners that b belongs to (corner_of).
template <class F>
BIGTRI_HD F interpolate(const F b[3], float a0, float a1, float a2) {
  return (b[0] * a0 + b[1] * a1) + b[2] * a2;
}

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri
