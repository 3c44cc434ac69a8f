// The names of the CPU's variants; the first is what "auto" means. Each is a file <name>.cpp here, which defines
// <name>_variant. variants.cpp makes a table of them.
#pragma once

#define BIGTRI_CPU_VARIANTS(X) X(bin_owned) X(scanline)
