// Writes the (bin, entry) pairs of records: the counting step of the sort in bin_owned.cpp, which calls bin_records for
// each run of records. Compiled once per instruction set.
#pragma once

#include "kernels.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

// Small records enter every candidate. Large records enter the candidates that no edge rejects.
int64_t bin_records(const BinJob& job, int64_t begin, int64_t end, BinPair* pairs, uint32_t* counts, Counts* work) {
  const int bins_x = job.bins_x;
  int64_t n = 0, view = 0;
  for (int64_t i = begin; i < end; ++i) {
    if (!job.candidates[i]) continue;
    while (i >= job.view_begin[view + 1]) ++view;
    const uint32_t first = (uint32_t)(view * job.bins);
    const Record& r = job.records[i];
    const int c0 = r.x0 / kBin, c1 = (r.x1 - 1) / kBin, r0 = r.y0 / kBin, r1 = (r.y1 - 1) / kBin;
    if (!(r.flags & kRecordLarge)) {
      work->add(Counter::by_rows, 1);
      for (int y = r0; y <= r1; ++y)
        for (int x = c0; x <= c1; ++x) {
          const uint32_t bin = first + (uint32_t)(y * bins_x + x);
          pairs[n++] = {bin, (uint32_t)i << kEntryShift | kEntrySmall};
          ++counts[bin];
        }
      continue;
    }
    work->add(Counter::by_tiles, 1);
    work->add(Counter::bins_tested, job.candidates[i]);
    work->add(Counter::bins_rejected, job.candidates[i]);  // less those that are kept
    // Each edge's highest and lowest value over a bin is linear in the bin's column, so both are stepped along the row.
    BinEdge corner[3];
    for (int k = 0; k < 3; ++k) corner[k] = bin_edge(edge_of(r.x, r.y, k), c0, r0);
    for (int y = r0; y <= r1; ++y) {
      int64_t high[3], low[3], step[3];
      for (int k = 0; k < 3; ++k) {
        const int64_t down = (int64_t)((y - r0) * kBin) * corner[k].sy;
        high[k] = corner[k].highest + down;
        low[k] = corner[k].lowest + down;
        step[k] = (int64_t)kBin * corner[k].sx;
      }
      for (int x = c0; x <= c1; ++x) {
        work->add_edges(Counter::edges_64, 3, x * kBin, y * kBin, kBin);
        // An OR is negative if one of its operands is: no edge rejects the bin.
        if ((high[0] | high[1] | high[2]) >= 0) {
          const uint32_t bin = first + (uint32_t)(y * bins_x + x),
                         full = (low[0] | low[1] | low[2]) >= 0 ? kEntryFull : 0;
          pairs[n++] = {bin, (uint32_t)i << kEntryShift | full};
          ++counts[bin];
          work->add(Counter::bins_rejected, -1);
          work->add(Counter::bins_accepted, full != 0);
          work->add_edges(Counter::edges_64, 3, x * kBin, y * kBin, kBin);
        }
        for (int k = 0; k < 3; ++k) {
          high[k] += step[k];
          low[k] += step[k];
        }
      }
    }
  }
  return n;
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri
