// The registry of variants on the GPU: which are compiled for which rung, the one that "auto" means first. setup.py
// compiles what is listed here. A list stands on one line: setup.py, .ci/run and tests/cuda/cuda_on_cpu.py read it.
#pragma once

#define BIGTRI_CUDA_VARIANTS_exact(X) X(bin_owned) X(two_stage) X(persistent)
#define BIGTRI_CUDA_VARIANTS_balanced(X) X(two_stage)
#define BIGTRI_CUDA_VARIANTS_fast(X) X(two_stage)
#define BIGTRI_CUDA_VARIANTS_subpixel4(X) X(two_stage)
