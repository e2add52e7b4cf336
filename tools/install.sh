#!/usr/bin/env bash
# install.sh VENV ARGUMENTS: pip install into VENV. `uv` is only faster: where it cannot be had, pip installs the same.
set -euo pipefail

bin=$1/bin
shift
if [ -x "$bin/uv" ]; then
    exec "$bin/uv" pip install -q --python "$bin/python" "$@"
fi
exec "$bin/python" -m pip install -q "$@"
