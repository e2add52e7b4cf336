#!/usr/bin/env bash
# install.sh VENV ARGUMENTS: pip install into VENV. `uv` is only faster: where it cannot be had, pip installs the same.
# BYTECODE=1: with compiled bytecode, as pip does. Where Python may not write any, every command would compile all it imports.
set -euo pipefail

bin=$1/bin
shift
if [ -x "$bin/uv" ]; then
    exec "$bin/uv" pip install -q ${BYTECODE:+--compile-bytecode} --python "$bin/python" "$@"
fi
exec "$bin/python" -m pip install -q "$@"
