#!/bin/sh
# Build the example against ONNX Runtime: build.sh ROOT [OUT], where ROOT is an unpacked release archive (include/, lib/).
set -eu
root=${1:?give the folder of an unpacked release archive of ONNX Runtime}
here=$(cd "$(dirname "$0")" && pwd)
exec "${CXX:-c++}" -std=c++17 -O2 -Wall -Wextra "$here/joints.cpp" -I"$root/include" -L"$root/lib" -lonnxruntime \
  -Wl,-rpath,"$root/lib" -o "${2:-$here/joints}"
