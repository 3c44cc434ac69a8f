// Textures, Lambert shading and sRGB encoding: cuts the elements into blocks and calls the kernels of attributes.inl
// and texture.inl over threads. The binding calls it. All rungs agree on these, so this file is compiled for the
// default rung alone. Their kernels are part of every rung's table, unused in the others.

#include <algorithm>
#include <array>
#include <cstring>

#include "kernels.h"

namespace bigtri {

template <class Code>
const float* decoded() {
  constexpr int kLast = (Code)-1, kStep = 65535 / kLast;
  static const std::array<float, kLast + 1> table = [] {
    const FloatMode mode;
    std::array<float, kLast + 1> values;
    for (int code = 0; code <= kLast; ++code) values[code] = decode_srgb(kStep * code);
    return values;
  }();
  return table.data();
}
template const float* decoded<uint8_t>();
template const float* decoded<uint16_t>();

const SrgbSteps& srgb_steps(const float* thresholds) {
  static thread_local SrgbSteps table;
  static thread_local float made_of[255];
  static thread_local bool made = false;
  if (!made || memcmp(made_of, thresholds, sizeof made_of) != 0) {
    const FloatMode mode;
    fill_srgb_steps(thresholds, &table);
    memcpy(made_of, thresholds, sizeof made_of);
    made = true;
  }
  return table;
}

std::vector<uint8_t> background_rows(const ShadeJob& job) {
  const FloatMode mode;
  const int n = job.samples, rows = job.height / n;
  std::vector<uint8_t> colors(4 * (size_t)rows);
  for (int row = 0; row < rows; ++row) {
    float total[3] = {0.0f, 0.0f, 0.0f};
    for (int i = 0; i < n * n; ++i) {
      float one[3];
      background_at(job.surface, row * n + i / n, job.height, job.channels, one);
      for (int c = 0; c < 3; ++c) total[c] = total[c] + one[c];
    }
    store_mean(total, 0, n * n, job.channels, *job.srgb, colors.data() + 4 * row);
  }
  return colors;
}

namespace {

// body(begin, end) for blocks of `step` elements out of `count`.
template <class Body>
void in_blocks(const Parallel& parallel, int64_t count, int64_t step, const Body& body) {
  parallel((count + step - 1) / step, [&](int64_t i) { body(i * step, std::min(count, (i + 1) * step)); });
}

// A texture as its kernel takes it, and that kernel.
const float* texels_of(const float* texture) { return texture; }
template <class Code>
CodedTexels<Code> texels_of(const Code* texture) {
  return {texture, decoded<Code>()};
}
auto kernel_for(const float*) { return current_kernels().attributes.sample; }
auto kernel_for(const uint8_t*) { return current_kernels().attributes.sample_codes8; }
auto kernel_for(const uint16_t*) { return current_kernels().attributes.sample_codes16; }

}  // namespace

template <class Code>
void sample(const Code* texture, int height, int width, int64_t channels, const float* uv, int64_t count, Filter filter,
            Wrap wrap, float* out, const Parallel& parallel) {
  const auto texels = texels_of(texture);
  in_blocks(parallel, count, 16384, [&](int64_t begin, int64_t end) {
    kernel_for(texture)(texels, height, width, channels, uv + 2 * begin, end - begin, filter, wrap,
                        out + channels * begin);
  });
}
template void sample(const float*, int, int, int64_t, const float*, int64_t, Filter, Wrap, float*, const Parallel&);
template void sample(const uint8_t*, int, int, int64_t, const float*, int64_t, Filter, Wrap, float*, const Parallel&);
template void sample(const uint16_t*, int, int, int64_t, const float*, int64_t, Filter, Wrap, float*, const Parallel&);

void lambert(const float* normals, const float* albedo, const float* ambient, const float* directions,
             const float* colors, int64_t lights, int64_t count, float* out, const Parallel& parallel) {
  in_blocks(parallel, count, 16384, [&](int64_t begin, int64_t end) {
    current_kernels().attributes.lambert(normals + 3 * begin, albedo + 3 * begin, ambient, directions, colors, lights,
                                         end - begin, out + 3 * begin);
  });
}

void encode_srgb(const float* linear, const float* thresholds, int64_t count, uint8_t* out, const Parallel& parallel) {
  const SrgbSteps& table = srgb_steps(thresholds);
  in_blocks(parallel, count, 65536, [&](int64_t begin, int64_t end) {
    current_kernels().attributes.encode_srgb(linear + begin, table, end - begin, out + begin);
  });
}

}  // namespace bigtri
