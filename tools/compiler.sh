#!/usr/bin/env bash
# compiler.sh VENV [TARGET]: prints what CMake is to build the extension with, as `NAME=PATH` words: $CXX if it is set, else the first
# C++20 compiler on the PATH, else the one that comes as the wheel `ziglang`, which is then installed into VENV. For a TARGET, such as
# x86_64-linux-gnu.2.28 (an older glibc than the one here), it is `ziglang` in any case.
set -euo pipefail

bin=$1/bin
target=${2:-}
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cat > "$folder/probe.cpp" << 'EOF'
#include <bit>
#include <concepts>
template <std::integral T> T twice(T x) { return 2 * x; }
int probe() { return twice(std::bit_cast<int>(0.0f)); }
EOF

compiles() { "$1" -std=c++20 -shared -fPIC "$folder/probe.cpp" -o "$folder/probe.so" 2>"$folder/said"; }

if [ -z "$target" ]; then
    for compiler in ${CXX:-c++ g++ clang++}; do
        command -v "$compiler" >/dev/null || continue
        if compiles "$compiler"; then
            echo "CMAKE_CXX_COMPILER=$(command -v "$compiler")"
            exit 0
        fi
        echo "$compiler does not compile C++20: $(grep -m1 -i error "$folder/said" || "$compiler" --version | head -1)" >&2
    done
    if [ -n "${CXX:-}" ]; then
        echo "hint: name a C++20 compiler (g++ 11 or newer, clang++ 14 or newer) in CXX, or leave CXX unset" >&2
        exit 2
    fi
    echo "no C++20 compiler on the PATH (Debian: apt-get install g++): going on with the one in the wheel ziglang, four minutes once" >&2
fi

"$bin/python" -m pip install -q -r requirements-compiler.lock >&2
for tool in c++ ar ranlib; do
    printf '#!/bin/sh\nexec "%s" -m ziglang %s "$@"\n' "$(cd "$bin" && pwd)/python" "$tool" > "$bin/zig-$tool"
    chmod +x "$bin/zig-$tool"
done
# Zig builds for the processor it runs on unless told otherwise, and traps undefined behaviour.
sed -i "s/ziglang c++/ziglang c++ ${target:+-target $target }-mcpu=baseline -fno-sanitize=undefined/" "$bin/zig-c++"
here=$(cd "$bin" && pwd)
echo "CMAKE_CXX_COMPILER=$here/zig-c++ CMAKE_AR=$here/zig-ar CMAKE_RANLIB=$here/zig-ranlib CMAKE_STRIP=$(command -v true)"
