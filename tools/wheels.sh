#!/usr/bin/env bash
# wheels.sh FOLDER: a release in FOLDER: the source distribution, and from it a wheel for Python 3.11 and one for 3.12 and later (the
# stable ABI), each with both builds of the kernels, for any Linux with glibc 2.28 or newer. The compiler is the locked wheel `ziglang`,
# whatever else there is: it links its own C++ library and the glibc that it is told, where a newer system's own compiler would ask every
# machine for a glibc as new as that system's.
set -euo pipefail

out=$1
work=build/wheels
glibc=2.28
machine=$(uname -m)

pythons=()
for versions in "3.11" "3.12 3.13 3.14"; do
    for version in $versions; do
        python=$(command -v "python$version") && "$python" -c "" 2>/dev/null && break || python=""
    done
    if [ -z "$python" ]; then
        echo "no Python ${versions// / or } on the PATH: its wheel cannot be built" >&2
        echo "hint: install one beside yours, and put its folder on the PATH" >&2
        exit 2
    fi
    pythons+=("$python")
done

mkdir -p "$out" "$work"
rm -rf "$out"/cabinpose-*.{whl,tar.gz} "$work/raw"
for python in "${pythons[@]}"; do
    venv=$work/$("$python" -c "import sys; print(sys.implementation.cache_tag)")
    [ -x "$venv/bin/python" ] || "$python" -m venv "$venv"
    "$venv/bin/python" -m pip install -q -r requirements-release.lock
    [ -e "$out"/cabinpose-*.tar.gz ] || "$venv/bin/python" -c "from scikit_build_core.build import build_sdist; build_sdist('$out')"
    defines=$(tools/compiler.sh "$venv" "$machine-linux-gnu.$glibc")
    LOG=$venv/build.log tools/patiently.sh "building the wheel of $("$python" --version)" \
        "$venv/bin/python" -m pip wheel -v --no-build-isolation --no-deps -w "$work/raw" -C cmake.define.CABINPOSE_KERNELS=all \
        $(printf -- '-C cmake.define.%s ' $defines) "$out"/cabinpose-*.tar.gz
done
# It refuses a wheel whose kernels ask for a newer glibc, or for libraries that not every Linux has.
PATH=$venv/bin:$PATH "$venv/bin/auditwheel" repair --plat "manylinux_${glibc/./_}_$machine" --only-plat -w "$out" "$work"/raw/*.whl
ls -l "$out"
