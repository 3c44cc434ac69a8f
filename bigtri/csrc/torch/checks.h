// Argument checks shared by all operators. A failed check throws; its text names the operator and the argument, and
// says what is allowed and what came.
#pragma once

#include <torch/csrc/inductor/aoti_torch/c/shim.h>
#include <torch/csrc/stable/library.h>
#include <torch/csrc/stable/ops.h>
#include <torch/csrc/stable/tensor.h>
#include <torch/headeronly/core/ScalarType.h>

#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "../cpu/backend.h"

namespace bigtri {

using torch::headeronly::ScalarType;
using torch::stable::Tensor;
using Sizes = torch::headeronly::IntHeaderOnlyArrayRef;  // borrowed: {-1, 4} as an argument lives as long as the call

// Error texts are made here and not by STD_TORCH_CHECK, which puts the path of this file on the build machine into each
// of them. They are made without streams: a toolchain that links libstdc++ statically brings a second set of locales,
// which clashes with that of torch's libstdc++, and printing a number crashes.
inline std::string text_of(const char* v) { return v; }
inline std::string text_of(const std::string& v) { return v; }
inline std::string text_of(Sizes shape) {
  std::string s;
  for (const int64_t size : shape) s += (s.empty() ? "[" : ", ") + std::to_string(size);
  return s.empty() ? "[]" : s + "]";
}
template <class Number>
std::string text_of(Number v) {
  return std::to_string(v);
}

template <class... Parts>
[[noreturn]] void fail(const Parts&... parts) {
  std::string text;
  ((text += text_of(parts)), ...);
  throw std::runtime_error(text);
}
#define BIGTRI_CHECK(CONDITION, ...) \
  if (!(CONDITION)) fail(__VA_ARGS__)

// None for a dtype that the stable ABI does not know.
inline std::optional<ScalarType> type_of(const Tensor& t) {
  try {
    return t.scalar_type();
  } catch (const std::exception&) {
    return std::nullopt;
  }
}

// Whether the storage of a contiguous tensor holds all its elements: a storage can be resized under its tensors.
inline bool has_memory(const Tensor& t) {
  int64_t bytes = 0;
  TORCH_ERROR_CODE_CHECK(aoti_torch_get_storage_size(t.get(), &bytes));
  return t.numel() == 0 || t.storage_offset() + t.numel() <= bytes / (int64_t)t.element_size();
}

inline std::string describe(const Tensor& t) {
  if (!t.defined()) return "None";
  const auto type = type_of(t);
  return std::string(type ? torch::headeronly::toString(*type) : "another dtype") + " " + text_of(t.sizes()) +
         (t.is_cpu() ? " on the CPU" : " on device " + std::to_string(t.get_device_index())) +
         (!t.is_contiguous()       ? ", not contiguous"
          : type && !has_memory(t) ? ", without memory for all of it"
                                   : "");
}

inline bool fits(const Tensor& t, ScalarType type, Sizes shape) {
  if (type_of(t) != type || !t.is_contiguous() || !has_memory(t)) return false;
  const Sizes sizes = t.sizes();
  bool ok = sizes.size() == shape.size();
  for (size_t i = 0; ok && i < shape.size(); ++i) ok = shape[i] < 0 || sizes[i] == shape[i];
  return ok;
}

// A size of -1 in `shape` allows any size. `wanted` says the same for the error text.
inline void check(const char* op, const char* name, const Tensor& t, ScalarType type, Sizes shape, const char* wanted) {
  BIGTRI_CHECK(t.defined() && t.is_cpu() && fits(t, type, shape), "bigtri::", op, ": ", name,
               " must be a contiguous CPU tensor, ", wanted, ", got ", describe(t));
}

inline void check_cuda(const char* op, const char* name, const Tensor& t, int device, ScalarType type, Sizes shape,
                       const char* wanted) {
  BIGTRI_CHECK(t.defined() && t.is_cuda() && t.get_device_index() == device && fits(t, type, shape), "bigtri::", op,
               ": ", name, " must be a contiguous tensor on CUDA device ", device, ", ", wanted, ", got ", describe(t));
}

constexpr int kCpu = -1;

inline void check_on(const char* op, const char* name, const Tensor& t, int device, ScalarType type, Sizes shape,
                     const char* wanted) {
  if (device == kCpu)
    check(op, name, t, type, shape, wanted);
  else
    check_cuda(op, name, t, device, type, shape, wanted);
}

inline void check_size(const char* op, int64_t height, int64_t width) {
  BIGTRI_CHECK(height >= 1 && height <= kMaxSize && width >= 1 && width <= kMaxSize, "bigtri::", op,
               ": height and width must be 1 to ", kMaxSize, ", got ", height, " and ", width);
}

inline void check_count(const char* op, const char* name, int64_t count) {
  BIGTRI_CHECK(count <= INT32_MAX, "bigtri::", op, ": ", name, " must have at most 2147483647 rows, got ", count);
}

// An output must not overlap an input: it is written while the input is still read.
inline void check_apart(const char* op, const char* output_name, const Tensor& output, const char* input_name,
                        const Tensor& input) {
  const char *a = static_cast<const char*>(output.const_data_ptr()),
             *b = static_cast<const char*>(input.const_data_ptr());
  const size_t a_size = (size_t)output.numel() * output.element_size(),
               b_size = (size_t)input.numel() * input.element_size();
  BIGTRI_CHECK(a + a_size <= b || b + b_size <= a, "bigtri::", op, ": ", output_name, " must not share memory with ",
               input_name);
}

template <class T>
T* data(const Tensor& t) {
  return static_cast<T*>(t.mutable_data_ptr());
}
template <class T>
const T* const_data(const Tensor& t) {
  return static_cast<const T*>(t.const_data_ptr());
}

// New memory, contiguous. torch::stable::empty looks its operator up by name in every call.
inline Tensor empty(Sizes shape, ScalarType type, int device = kCpu) {
  std::vector<int64_t> strides(shape.size(), 1);
  for (size_t i = shape.size(); i-- > 1;) strides[i - 1] = strides[i] * (shape[i] > 1 ? shape[i] : 1);
  const int32_t dtype = (int32_t)torch::stable::detail::from(type);
  const int32_t kind = device == kCpu ? aoti_torch_device_type_cpu() : aoti_torch_device_type_cuda();
  AtenTensorHandle made = nullptr;
  if (aoti_torch_empty_strided((int64_t)shape.size(), shape.data(), strides.data(), dtype, kind,
                               device == kCpu ? 0 : device, &made) != AOTI_TORCH_SUCCESS)
    fail("bigtri: no memory for a tensor ", torch::headeronly::toString(type), " ", shape);
  return Tensor(made);
}

constexpr int kMostThreads = 1024;  // each takes memory

// What the operator thread_load measures; while its `threads` is 0, nothing.
inline Load measured_load;

// As many threads as torch uses (torch.set_num_threads), of bigtri's own pool.
inline Parallel torch_threads() {
  if (measured_load.threads) return {measured_load.threads, &measured_load};
  return {(int)min_of<int64_t>(torch::stable::get_num_threads(), kMostThreads)};
}

// The whole image.
inline Viewport viewport(const char* op, int64_t height, int64_t width, const std::string& cull) {
  check_size(op, height, width);
  BIGTRI_CHECK(cull == "none" || cull == "back" || cull == "front", "bigtri::", op,
               ": cull must be 'none', 'back' or 'front', got '", cull, "'");
  return {(int)width,
          (int)height,
          0,
          0,
          (int)width,
          (int)height,
          cull == "back"    ? kCullBack
          : cull == "front" ? kCullFront
                            : kCullNone};
}

inline Viewport viewport(const char* op, int64_t height, int64_t width, const std::string& cull,
                         const std::vector<int64_t>& scissor) {
  Viewport view = viewport(op, height, width, cull);
  BIGTRI_CHECK(scissor.size() == 4, "bigtri::", op, ": scissor must be 4 integers x0, y0, x1, y1, got ",
               scissor.size());
  const auto cut = [](int64_t v, int64_t high) { return (int)min_of(max_of<int64_t>(v, 0), high); };
  view.x0 = cut(scissor[0], width);
  view.y0 = cut(scissor[1], height);
  view.x1 = cut(scissor[2], width);
  view.y1 = cut(scissor[3], height);
  return view;
}

// The lowest and the highest vertex index.
struct Indices {
  int64_t lowest = INT32_MAX, highest = INT32_MIN;  // where there are no triangles
};

// Throws if an index names no vertex.
inline Indices checked_indices(const char* op, const Parallel& parallel, const Tensor& triangles, int64_t vertices) {
  Indices found;
  const int64_t count = triangles.size(0);
  if (count == 0) return found;
  BIGTRI_CHECK(vertices > 0, "bigtri::", op, ": triangles must be empty where positions is, got ", count, " triangles");
  index_range(parallel, const_data<int32_t>(triangles), 3 * count, &found.lowest, &found.highest);
  BIGTRI_CHECK(found.lowest >= 0 && found.highest < vertices, "bigtri::", op, ": triangles must index positions, 0 to ",
               vertices - 1, ", got indices from ", found.lowest, " to ", found.highest);
  return found;
}

}  // namespace bigtri
