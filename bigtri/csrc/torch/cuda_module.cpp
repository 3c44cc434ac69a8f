// The Python module `bigtri._cuda`. It is empty: importing it loads the library, and static initialisers register the
// CUDA kernels of the operators. `bigtri._C` defines the operators and must be imported first.

#include <Python.h>

PyMODINIT_FUNC PyInit__cuda(void) {
  static PyModuleDef definition = {
      PyModuleDef_HEAD_INIT, "_cuda", nullptr, -1, nullptr, nullptr, nullptr, nullptr, nullptr};
  return PyModule_Create(&definition);
}
