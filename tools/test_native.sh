#!/usr/bin/env bash
# test_native.sh BIN [PYTEST ARGUMENTS]: builds the kernels under the address and undefined-behaviour sanitizers and runs their tests.
set -euo pipefail

bin=$(cd "$1" && pwd)
shift
out=build/sanitized
"$bin/cmake" -S . -B "$out/cmake" -G Ninja -DPython_EXECUTABLE="$bin/python" -DCMAKE_MAKE_PROGRAM="$bin/ninja" \
    -DCABINPOSE_SANITIZE=address,undefined -DCABINPOSE_WERROR=ON >/dev/null
"$bin/cmake" --build "$out/cmake"
"$bin/cmake" --install "$out/cmake" --prefix "$out" >/dev/null

# Python leaks by design at its end. The first finding ends the run.
export ASAN_OPTIONS=detect_leaks=0:abort_on_error=1 UBSAN_OPTIONS=halt_on_error=1:print_stacktrace=1
export CABINPOSE_NATIVE=$out/cabinpose/_native
[ $# -gt 0 ] || set -- tests/native tests/body tests/contact tests/posture tests/render tests/sensor tests/estimate/test_{dpm,walks}.py
LD_PRELOAD=$(${CXX:-c++} -print-file-name=libasan.so):$(${CXX:-c++} -print-file-name=libubsan.so) \
    "$bin/python" -m pytest -q -p no:cacheprovider -m "not slow" "$@"
