// torch.ops.bigtri.rasterize on the CPU, the choice of the instruction set, and the schemas of all operators. The
// library `_cuda` adds kernels to these schemas.

#include <tuple>

#include "../cpu/workspace.h"
#include "frames.h"
#include "rasterize_checks.h"
#include "registry.h"
#include "work_map_checks.h"

namespace bigtri {
namespace {

std::string variants_op(std::string precision) {
  return registry_text(find_rung("variants", kCpuRungs, precision).variants);
}

std::string rungs_op() { return rung_names(kCpuRungs); }

// One line for each counter, its fields separated by tabs; bigtri/native.py parses them.
std::string counters_op() {
  std::string lines;
#define BIGTRI_COUNTER(NAME, DEPENDS, ABOUT) lines += #NAME "\t" #DEPENDS "\t" ABOUT "\n";
  BIGTRI_COUNTERS(BIGTRI_COUNTER)
#undef BIGTRI_COUNTER
  return lines;
}

void rasterize_op(const Tensor& positions, const Tensor& triangles, int64_t height, int64_t width,
                  const std::string& cull, const std::vector<int64_t>& scissor, const std::string& variant,
                  const std::string& precision, int64_t samples, const std::vector<int64_t>& parameters,
                  const std::optional<Tensor>& ranges, const std::optional<Tensor>& behind, const Tensor& packed,
                  const std::optional<Tensor>& depth, const Tensor& dropped, const std::optional<Tensor>& counters) {
  const char* op = "rasterize";
  const Viewport view = viewport(op, height, width, cull, scissor);
  const CpuRung& rung = find_rung(op, kCpuRungs, precision);
  BIGTRI_CHECK(!counters || rung.counting, "bigtri::", op, ": counters must be None with precision '", precision,
               "', whose variants count nothing");
  const Variant& chosen = find_variant(op, counters ? rung.counting : rung.variants, variant, precision, "");
  const std::vector<int64_t> values = checked_parameters(op, chosen, parameters);
  check_unserved(samples, behind);
  const int32_t views = checked_views(kCpu, positions, triangles, ranges);
  check_results(kCpu, views, positions, triangles, height, width, ranges, packed, depth, dropped);
  if (counters) check(op, "counters", *counters, ScalarType::Long, {kCounters}, "int64 [one for each counter]");
  const Parallel parallel = torch_threads();
  CheckedFrame frame = checked_frame(op, parallel, view, views, positions, triangles, ranges);
  set_results(&frame, &packed, depth, dropped);
  frame.counters = counters ? data<int64_t>(*counters) : nullptr;
  chosen.draw(frame, parallel, values.data());
}

// One view, drawn by a variant that counts. More tasks may draw than `tasks` has room for; counters has their number.
void map_work_op(const Tensor& positions, const Tensor& triangles, int64_t height, int64_t width,
                 const std::string& cull, const std::vector<int64_t>& scissor, const std::string& variant,
                 const std::string& precision, const std::vector<int64_t>& parameters, const Tensor& packed,
                 const Tensor& dropped, const Tensor& counters, const Tensor& fragments, const Tensor& edges,
                 const Tensor& tasks) {
  const char* op = "map_work";
  const Viewport view = viewport(op, height, width, cull, scissor);
  const CpuRung& rung = find_rung(op, kCpuRungs, precision);
  BIGTRI_CHECK(rung.counting, "bigtri::", op, ": precision must be one whose variants count, got '", precision, "'");
  const Variant& chosen = find_variant(op, rung.counting, variant, precision, "");
  const std::vector<int64_t> values = checked_parameters(op, chosen, parameters);
  const int columns = (view.width + kBin - 1) / kBin, rows = (view.height + kBin - 1) / kBin;
  check_map_work(kCpu, view, WorkMap::squares(columns, rows), positions, triangles, packed, dropped, counters,
                 fragments, edges, tasks);
  const Parallel parallel = torch_threads();
  CheckedFrame frame = checked_frame(op, parallel, view, 1, positions, triangles);
  WorkMap map = {columns, rows, data<int64_t>(fragments), data<int64_t>(edges), data<int64_t>(tasks), tasks.size(0), 0};
  set_results(&frame, &packed, std::nullopt, dropped);
  frame.counters = data<int64_t>(counters);
  frame.map = &map;
  chosen.draw(frame, parallel, values.data());
}

// What is drawn by the standard variant, where a call has no more than the usual arguments.
struct StandardFrame {
  const Variant& variant;
  Parallel parallel;
  CheckedFrame frame;
};

// Checks the inputs; the frame has no results yet.
StandardFrame standard_frame(const Tensor& positions, const Tensor& triangles, int64_t height, int64_t width,
                             const std::string& cull, const std::optional<std::vector<int64_t>>& scissor,
                             const std::string& precision) {
  const char* op = "rasterize";
  const Viewport view = scissor ? viewport(op, height, width, cull, *scissor) : viewport(op, height, width, cull);
  const Variant& standard = *find_rung(op, kCpuRungs, precision).variants[0];
  const int32_t views = checked_views(kCpu, positions, triangles, std::nullopt);
  const Parallel parallel = torch_threads();
  return {standard, parallel, checked_frame(op, parallel, view, views, positions, triangles)};
}

void draw(StandardFrame* given, const Tensor& packed, const std::optional<Tensor>& depth, const Tensor& dropped) {
  set_results(&given->frame, &packed, depth, dropped);
  given->variant.draw(given->frame, given->parallel, standard_values(given->variant).data());
}

NewResults rasterize_new_op(const Tensor& positions, const Tensor& triangles, int64_t height, int64_t width,
                            const std::string& cull, const std::optional<std::vector<int64_t>>& scissor,
                            const std::string& precision, bool depth) {
  StandardFrame given = standard_frame(positions, triangles, height, width, cull, scissor, precision);
  NewResults made = new_results(kCpu, positions, height, width, depth);
  const auto& [packed, image, dropped] = made;
  draw(&given, packed, image, dropped);
  return made;
}

Tensor rasterize_into_op(const Tensor& positions, const Tensor& triangles, int64_t height, int64_t width,
                         const Tensor& packed, const std::optional<Tensor>& depth, const std::string& cull,
                         const std::optional<std::vector<int64_t>>& scissor, const std::string& precision) {
  StandardFrame given = standard_frame(positions, triangles, height, width, cull, scissor, precision);
  const Tensor dropped = new_dropped(kCpu, positions);
  check_results(kCpu, given.frame.views, positions, triangles, height, width, std::nullopt, packed, depth, dropped);
  draw(&given, packed, depth, dropped);
  return dropped;
}

bool has_isa(std::string name) {
  Isa isa;
  return find_isa(name, &isa);
}

int64_t workspace_bytes_op() { return kept_workspace_bytes(); }

void release_workspaces_op() { release_workspaces(); }

std::string isa() { return name_of(current_isa()); }

void set_isa(std::string name) {
  Isa isa;
  BIGTRI_CHECK(find_isa(name, &isa),
               "bigtri::set_isa: name must be an instruction set of this machine ('baseline', 'avx2', 'avx512'), got '",
               name, "'");
  use_isa(isa);
}

// Returns what has been measured since the last call: the time of the thread that works longest, and of all (Load). From
// now on measures how `threads` threads would share the work of every operator, which the caller's thread does alone; 0:
// nothing. For the whole process, which must not call operators from several threads meanwhile.
std::tuple<int64_t, int64_t> thread_load_op(int64_t threads) {
  BIGTRI_CHECK(threads >= 0 && threads <= kMostThreads, "bigtri::thread_load: threads must be 0 to ", kMostThreads,
               ", got ", threads);
  const Load measured = measured_load;
  measured_load = {(int)threads, 0, 0};
  return {measured.longest, measured.all};
}

}  // namespace
}  // namespace bigtri

STABLE_TORCH_LIBRARY(bigtri, m) {
  m.def(
      // No argument is keyword-only: torch takes 0.2 us to look one up by its name.
      "rasterize(Tensor positions, Tensor triangles, int height, int width, str cull, int[] scissor, str variant, "
      "str precision, int samples, int[] parameters, Tensor? ranges, Tensor? behind, Tensor(a!) packed, "
      "Tensor(b!)? depth, Tensor(c!) dropped, Tensor(d!)? counters) -> ()");
  m.def(
      "map_work(Tensor positions, Tensor triangles, int height, int width, str cull, int[] scissor, str variant, str "
      "precision, int[] parameters, Tensor(a!) packed, Tensor(b!) dropped, Tensor(c!) counters, Tensor(d!) fragments, "
      "Tensor(e!) edges, Tensor(f!) tasks) -> ()");
  // rasterize into new memory, by the standard variant: what most calls are. torch takes 0.1 to 0.5 us for each argument
  // that is given, half of that for one that is not, and longer to make a tensor for Python than for an operator.
  m.def(
      "rasterize_new(Tensor positions, Tensor triangles, int height, int width, str cull='none', int[]? scissor=None, "
      "str precision='exact', bool depth=True) -> (Tensor packed, Tensor? depth_image, Tensor dropped)");
  // The same into memory that the caller gives. Returns what is dropped.
  m.def(
      "rasterize_into(Tensor positions, Tensor triangles, int height, int width, Tensor(a!) packed, Tensor(b!)? "
      "depth=None, str cull='none', int[]? scissor=None, str precision='exact') -> Tensor");
  m.def("has_isa(str name) -> bool");
  m.def("isa() -> str");
  m.def("set_isa(str name) -> ()");
  m.def("thread_load(int threads) -> (int longest, int all)");
  m.def("workspace_bytes() -> int");
  m.def("release_workspaces() -> ()");
  m.def("rungs() -> str");
  m.def("variants(str precision) -> str");
  m.def("counters() -> str");
  // The stages one by one; docs/architecture.md has their inputs and outputs.
  m.def(
      "setup(Tensor positions, Tensor triangles, int height, int width, *, str cull, int[] scissor, str precision) -> "
      "(Tensor triangle, Tensor xy, Tensor z, "
      "Tensor area, Tensor bbox, Tensor w, Tensor corner, Tensor weights, Tensor clipped, Tensor dropped)");
  m.def(
      "binning(Tensor xy, Tensor bbox, int threshold, *, str precision) -> (Tensor candidates, Tensor kept, Tensor "
      "small)");
  m.def("tile_mask(Tensor xy, Tensor bbox, Tensor queue, *, str precision) -> (Tensor touched, Tensor full)");
  m.def("scanline(Tensor xy, Tensor bbox, Tensor queue, Tensor touched, Tensor small, *, str precision) -> Tensor");
  m.def("depth(Tensor xy, Tensor z, Tensor area, Tensor spans, *, str precision) -> Tensor");
  m.def("visibility(Tensor triangle, Tensor spans, Tensor depth, *, Tensor(a!) out) -> ()");
  // The attribute pass: as with rasterize, no argument is keyword-only.
  m.def(
      "interpolate(Tensor packed, Tensor positions, Tensor triangles, Tensor attributes, str precision, Tensor(a!) "
      "out) -> ()");
  m.def("barycentrics(Tensor packed, Tensor positions, Tensor triangles, str precision, Tensor(a!) out) -> ()");
  m.def("sample_texture(Tensor texture, Tensor uv, str filter, str wrap, Tensor(a!) out) -> ()");
  m.def(
      "lambert(Tensor normals, Tensor albedo, Tensor ambient, Tensor light_directions, Tensor light_colors, "
      "Tensor(a!) out) -> ()");
  m.def("encode_srgb(Tensor linear, Tensor thresholds, Tensor(a!) out) -> ()");
  m.def("transform(Tensor points, Tensor matrices, Tensor(a!) out) -> ()");
  // Pictures: the shading pass over a visibility buffer, and from triangles. The surface is uvs to two_sided.
  m.def(
      "shade(Tensor packed, Tensor positions, Tensor triangles, Tensor? uvs, Tensor? colors, Tensor? normals, Tensor? "
      "face_normals, Tensor material, Tensor looks, Tensor base_colors, Tensor[] textures, Tensor light_directions, "
      "Tensor light_colors, Tensor constants, bool two_sided, Tensor thresholds, str precision, Tensor(a!) image, "
      "Tensor(b!)? albedo, Tensor(c!)? normal_image, Tensor(d!)? linear) -> ()");
  m.def(
      "draw(Tensor positions, Tensor triangles, int height, int width, str cull, Tensor? uvs, Tensor? colors, Tensor? "
      "normals, Tensor? face_normals, Tensor material, Tensor looks, Tensor base_colors, Tensor[] textures, Tensor "
      "light_directions, Tensor light_colors, Tensor constants, bool two_sided, Tensor thresholds, str precision, "
      "int[] parameters, Tensor(a!) image, Tensor(b!)? albedo, Tensor(c!)? normal_image, Tensor(d!)? linear, "
      "Tensor(e!)? packed, Tensor(f!)? depth, Tensor(g!) dropped, bool fills=False) -> ()");
}

STABLE_TORCH_LIBRARY_IMPL(bigtri, CPU, m) {
  m.impl("rasterize", TORCH_BOX(&bigtri::rasterize_op));
  m.impl("map_work", TORCH_BOX(&bigtri::map_work_op));
  m.impl("rasterize_new", TORCH_BOX(&bigtri::rasterize_new_op));
  m.impl("rasterize_into", TORCH_BOX(&bigtri::rasterize_into_op));
}

STABLE_TORCH_LIBRARY_IMPL(bigtri, CompositeExplicitAutograd, m) {
  m.impl("has_isa", TORCH_BOX(&bigtri::has_isa));
  m.impl("isa", TORCH_BOX(&bigtri::isa));
  m.impl("set_isa", TORCH_BOX(&bigtri::set_isa));
  m.impl("thread_load", TORCH_BOX(&bigtri::thread_load_op));
  m.impl("workspace_bytes", TORCH_BOX(&bigtri::workspace_bytes_op));
  m.impl("release_workspaces", TORCH_BOX(&bigtri::release_workspaces_op));
  m.impl("rungs", TORCH_BOX(&bigtri::rungs_op));
  m.impl("variants", TORCH_BOX(&bigtri::variants_op));
  m.impl("counters", TORCH_BOX(&bigtri::counters_op));
}
