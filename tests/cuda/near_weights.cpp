// Weights by multiplication (near_weights.cuh, as cuda_on_cpu.py changes it for the host) and by the rule, for
// test_near_weights.py.
#include <cmath>

#define __device__
#define __forceinline__ inline
static double __fma_rn(double a, double b, double c) { return std::fma(a, b, c); }

#include "cuda/near_weights.cuh"

using namespace bigtri;

// Of pixels with edge values e [count, 3] of triangles with these w [count, 3]: near weights and the rule's [count, 3], and
// whether the near ones are sure [count]. t: null, or weights over the slots [count, 3, 3] of the records of clipped
// triangles.
extern "C" void weigh(int count, const int64_t* e, const double* w, const double (*t)[3][3], float* near, float* rule,
                      bool* sure) {
  for (int i = 0; i < count; ++i, e += 3, w += 3, near += 3, rule += 3) {
    double inverse_w[3], edge[3], b[3];
    for (int k = 0; k < 3; ++k) {
      inverse_w[k] = near_inverse(w[k]);
      edge[k] = (double)e[k];
    }
    const double area = (double)(e[0] + e[1] + e[2]);
    if (t) {
      sure[i] = near_weights(e, inverse_w, t[i], near);
      clipped_barycentrics(area, w, t[i], edge, b);
    } else {
      sure[i] = near_weights(e, inverse_w, near);
      whole_barycentrics(area, w, w[0] == w[1] && w[1] == w[2], edge, b);
    }
    for (int k = 0; k < 3; ++k) rule[k] = (float)b[k];
  }
}

extern "C" void invert(int count, const double* v, double* out) {
  for (int i = 0; i < count; ++i) out[i] = near_inverse(v[i]);
}
