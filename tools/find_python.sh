#!/usr/bin/env bash
# Prints a Python that can run cabinpose: the first argument if given, else the first fitting one on the PATH.
set -euo pipefail

wanted=${1:-}
fits='import sys; sys.exit(sys.version_info < (3, 11))'
for candidate in ${wanted:-python3 python3.14 python3.13 python3.12 python3.11 python}; do
    if command -v "$candidate" >/dev/null && "$candidate" -c "$fits" 2>/dev/null; then
        command -v "$candidate"
        exit 0
    fi
done
echo "cabinpose needs Python 3.11 or newer; ${wanted:-no python3 on the PATH} is not" >&2
echo "hint: install one (Debian: apt-get install python3 python3-venv) or name it: make PYTHON=/path/to/python3.11" >&2
exit 2
