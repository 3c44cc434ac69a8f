#!/usr/bin/env bash
# Builds, tests and measures on a machine with a CUDA GPU, in one call:
#
#     bench/gpu.sh                              build test bench
#     bench/gpu.sh build test bench best sweep scaling sanitize
#     OUT=/some/folder BENCH_ARGS="--scenes S1,S3 --kernels" bench/gpu.sh build bench
#     MODELS="duck.glb bunny.ply" bench/gpu.sh build models
#
# Steps: build, test, quick (a minute of benchmark, without floor), bench, models (bench and best on models of your own), best (auto
# against the best setting), variants (the report about all of them, with counters if BIGTRI_CUDA_COUNTING=1 was set for the build;
# fragments.py), smoke (bigtri tune, the counters and that report on two scenes), sweep (for cliffs), scaling, plot, sanitize. A step
# that fails does not keep the next one from running; the summary comes last, and the exit code is 1 if one failed. Logs, CSVs and
# pictures go to $OUT (default build/gpu).
#
#   OUT             folder of results
#   PYTHON          default python3, which must have torch for CUDA
#   BIGTRI_WHEELS   folder of wheels to install first, without a network; nothing is installed otherwise
#   BIGTRI_COMMIT   what the rows say where there is no .git
#   MODELS          files for the step models
#   TEST_ARGS BENCH_ARGS BEST_ARGS VARIANTS_ARGS SCALING_ARGS   more arguments for pytest, cuda_run.py, best.py, variants.py,
#                   cuda_scaling.py
#   BUILD_TIMEOUT TEST_TIMEOUT BENCH_TIMEOUT BEST_TIMEOUT VARIANTS_TIMEOUT SCALING_TIMEOUT SANITIZE_TIMEOUT   seconds (360, 240,
#                   300, 240, 240, 240, 240 for each tool)
set -u
cd "$(dirname "$0")/.." || exit 2
OUT=${OUT:-build/gpu}
PYTHON=${PYTHON:-python3}
mkdir -p "$OUT" || exit 2
OUT=$(cd "$OUT" && pwd)
export PYTHONPATH="$PWD${PYTHONPATH:+:$PYTHONPATH}"
steps=("$@")
[ ${#steps[@]} -gt 0 ] || steps=(build test bench)
summary=()
failed=0

# step NAME SECONDS LINES COMMAND...: runs it with a time limit, all output to $OUT/NAME.log, the last LINES on the screen.
step() {
  local name=$1 seconds=$2 lines=$3 start=$SECONDS code
  shift 3
  echo "== $name: $*"
  timeout -k 10 "$seconds" "$@" >"$OUT/$name.log" 2>&1
  code=$?
  tail -n "$lines" "$OUT/$name.log"
  local text="ok"
  if [ $code -eq 124 ] || [ $code -eq 137 ]; then text="TIMED OUT after $seconds s"; elif [ $code -ne 0 ]; then text="FAILED ($code)"; fi
  [ $code -eq 0 ] || failed=1
  summary+=("$(printf '%-20s %4d s  %s' "$name" $((SECONDS - start)) "$text")")
  return $code
}

# Where compute-sanitizer is, or nothing.
sanitizer() {
  command -v compute-sanitizer && return
  local home
  for home in "${CUDA_HOME:-/usr/local/cuda}" /usr/local/cuda; do
    [ -x "$home/bin/compute-sanitizer" ] && echo "$home/bin/compute-sanitizer" && return
    [ -x "$home/compute-sanitizer/compute-sanitizer" ] && echo "$home/compute-sanitizer/compute-sanitizer" && return
  done
}

nvidia-smi --query-gpu=name,driver_version,memory.total,clocks.sm,clocks.max.sm,power.draw,temperature.gpu --format=csv,noheader 2>&1 | tee "$OUT/nvidia-smi.txt"
"$PYTHON" -c 'import sys, torch; print("python", sys.version.split()[0], "torch", torch.__version__, "CUDA", torch.version.cuda, torch.cuda.is_available())'
if [ -n "${BIGTRI_WHEELS:-}" ]; then
  step wheels 120 3 "$PYTHON" -m pip install --quiet --no-index --no-deps "$BIGTRI_WHEELS"/*.whl
fi

for name in "${steps[@]}"; do
  case $name in
    build)
      step build "${BUILD_TIMEOUT:-360}" 3 env BIGTRI_CUDA=1 "$PYTHON" setup.py build_ext --inplace || grep -n -m 20 -i "error" "$OUT/build.log"
      ;;
    test)
      shopt -s nullglob
      files=(tests/cuda/test_cuda.py tests/cuda/test_cuda_[!o]*.py) # not test_cuda_on_cpu.py, which needs no GPU
      shopt -u nullglob
      # shellcheck disable=SC2086
      if [ ${#files[@]} -gt 0 ]; then
        step test-cuda "${TEST_TIMEOUT:-240}" 25 "$PYTHON" -m pytest -p no:cacheprovider "${files[@]}" ${TEST_ARGS:-}
      else
        summary+=("test-cuda            there are no tests")
      fi
      # shellcheck disable=SC2086
      step test-devices "${TEST_TIMEOUT:-240}" 15 "$PYTHON" -m pytest -p no:cacheprovider tests/hard_cases/test_hard_cases.py tests/ops/test_attributes.py -k cuda ${TEST_ARGS:-}
      ;;
    quick)
      # shellcheck disable=SC2086
      step quick 120 30 "$PYTHON" bench/cuda_run.py --methods graph --size 1080p --batches 64x256x256 --seconds 0.02 --no-floor --total 60 --csv "$OUT/quick.csv" ${BENCH_ARGS:-}
      ;;
    bench)
      # shellcheck disable=SC2086
      step bench "${BENCH_TIMEOUT:-300}" 80 "$PYTHON" bench/cuda_run.py --csv "$OUT/cuda.csv" ${BENCH_ARGS:-}
      ;;
    models)
      # shellcheck disable=SC2086
      step models "${BENCH_TIMEOUT:-300}" 80 "$PYTHON" bench/cuda_run.py --methods graph,host --csv "$OUT/models.csv" --model ${MODELS:-} ${BENCH_ARGS:-}
      # shellcheck disable=SC2086
      step models-best "${BEST_TIMEOUT:-240}" 80 "$PYTHON" bench/best.py --csv "$OUT/models_best.csv" --model ${MODELS:-} ${BEST_ARGS:-}
      ;;
    best)
      # shellcheck disable=SC2086
      step best "${BEST_TIMEOUT:-240}" 120 "$PYTHON" bench/best.py --csv "$OUT/cuda_best.csv" ${BEST_ARGS:-}
      ;;
    variants)
      # shellcheck disable=SC2086
      step variants "${VARIANTS_TIMEOUT:-240}" 40 "$PYTHON" bench/variants.py --device cuda --seconds 0.02 --total 220 --csv "$OUT/variants.csv" ${VARIANTS_ARGS:-}
      step fragments 120 40 "$PYTHON" bench/fragments.py --device cuda --seconds 0.05 --csv "$OUT/fragments.csv"
      ;;
    smoke)
      step smoke-tune 60 20 "$PYTHON" -m bigtri tune R4k S2 --device cuda --size 256x256 --seconds 0.2 --file "$OUT/tuning.json"
      step smoke-tuned 60 5 "$PYTHON" bench/best.py --scenes R4k,S2 --size 256x256 --batches none --seconds 0.02 --total 40 --tuning "$OUT/tuning.json"
      step smoke-count 60 12 "$PYTHON" -m pytest -p no:cacheprovider tests/cuda/test_cuda_counters.py
      step smoke-variants 60 20 "$PYTHON" bench/variants.py --device cuda --scenes R4k,S2 --size 256x256 --sweep S2 --approach R16k --distances 0.5,4 --move R16k-close --seconds 0.01 --total 45 --csv "$OUT/smoke_variants.csv"
      step smoke-fragments 60 12 "$PYTHON" bench/fragments.py --device cuda --scenes R4k,S2 --size 640x360 --seconds 0.02 --csv "$OUT/smoke_fragments.csv"
      ;;
    sweep)
      # shellcheck disable=SC2086
      step sweep "${SCALING_TIMEOUT:-240}" 60 "$PYTHON" bench/cuda_scaling.py --curves sweeps --csv "$OUT/cuda_sweeps.csv" ${SCALING_ARGS:-}
      ;;
    scaling)
      # shellcheck disable=SC2086
      step scaling "${SCALING_TIMEOUT:-240}" 40 "$PYTHON" bench/cuda_scaling.py --csv "$OUT/cuda_scaling.csv" ${SCALING_ARGS:-}
      ;;
    plot)
      arguments=()
      [ -s "$OUT/cuda.csv" ] && arguments+=(--run "$OUT/cuda.csv")
      [ -s "$OUT/cuda_scaling.csv" ] && arguments+=(--scaling "$OUT/cuda_scaling.csv")
      [ -s "$OUT/cuda_sweeps.csv" ] && arguments+=(--sweeps "$OUT/cuda_sweeps.csv")
      step plot 120 5 "$PYTHON" bench/cuda_plot.py "${arguments[@]}" --out "$OUT"
      ;;
    sanitize)
      tool=$(sanitizer)
      if [ -z "$tool" ]; then
        summary+=("sanitize             there is no compute-sanitizer")
        failed=1
        continue
      fi
      seconds=${SANITIZE_TIMEOUT:-240}
      only=(--kernel-name kns=bigtri) # not torch's kernels, if this release knows the option
      "$tool" --tool memcheck "${only[@]}" true >/dev/null 2>&1 || only=()
      # torch's allocator would hide what lies beyond a tensor: without its cache each tensor is an allocation of its own
      step sanitize-plain "$seconds" 5 "$PYTHON" bench/sanitize.py
      for check in memcheck racecheck synccheck; do
        extra=()
        [ $check = memcheck ] || extra=(--quick)
        step "sanitize-$check" $((seconds + 30)) 8 env PYTORCH_NO_CUDA_MEMORY_CACHING=1 "$tool" --tool $check --error-exitcode 9 \
          "${only[@]}" "$PYTHON" bench/sanitize.py --total "$seconds" "${extra[@]}"
        grep -m 5 -A 12 "=========.*\(Invalid\|Error\|Race\|Uninit\|Barrier\)" "$OUT/sanitize-$check.log"
      done
      ;;
    *)
      summary+=("$name                there is no such step")
      failed=1
      ;;
  esac
done

echo "== summary ($OUT)"
printf '%s\n' "${summary[@]}" | tee "$OUT/summary.txt"
exit $failed
