// determinism.cu for threads of a CPU.
#include "determinism.cu"
