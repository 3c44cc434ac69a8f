// The rungs of the precision ladder; docs/numerics.md 12. Mirrors bigtri/precision.py. Besides this file, only
// cuda/variants.h names rungs, where it lists the variants of each.
//
// A rung is a constant of the translation unit, as the instruction set is. Code that depends on the rung is compiled
// once per rung, with BIGTRI_RUNG defined as the rung's name, into an inline namespace of that name (numerics.h). So no
// function tests for the rung, and no template passes it along.
#pragma once

namespace bigtri {
namespace rungs {

struct exact {
  static constexpr int kSubpixelBits = 8;  // vertices snap to 1/256 px
};

struct subpixel4 : exact {
  static constexpr int kSubpixelBits = 4;  // vertices snap to 1/16 px
};

}  // namespace rungs
}  // namespace bigtri

// All rungs, the default first.
#define BIGTRI_RUNGS(X) X(exact) X(subpixel4)
