#!/usr/bin/env bash
# install.sh VENV ARGUMENTS: pip install into VENV. `uv` is only faster: where it cannot be had, pip installs the same.
# Both compile to bytecode: where Python may not write any, every process would compile all that it imports (torch and lightning: 3 s).
set -euo pipefail

bin=$1/bin
shift
if [ -x "$bin/uv" ]; then
    exec "$bin/uv" pip install -q --compile-bytecode --python "$bin/python" "$@"
fi
exec "$bin/python" -m pip install -q "$@"
