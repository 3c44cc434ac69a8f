// `import bigtri._cuda` loads the library, whose static initialisers register the operators; the module itself is empty. bigtri._C, which defines them, has to be loaded before.

#include <Python.h>

PyMODINIT_FUNC PyInit__cuda(void) {
  static PyModuleDef definition = {
      PyModuleDef_HEAD_INIT, "_cuda", nullptr, -1, nullptr, nullptr, nullptr, nullptr, nullptr};
  return PyModule_Create(&definition);
}
