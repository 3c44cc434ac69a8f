// The registry of variants on the CPU, the one that "auto" means first. Each is bigtri/csrc/cpu/<name>.cpp, which defines <name>_variant.
#pragma once

#define BIGTRI_CPU_VARIANTS(X) X(bin_owned) X(scanline)
