#!/usr/bin/env bash
# patiently.sh WORDS COMMAND...: runs a command that is silent for long, saying every ten seconds that it still runs. What the
# command says goes to the file LOG, where that is set.
set -euo pipefail

words=$1
shift
echo "$words"
if [ -n "${LOG:-}" ]; then "$@" >"$LOG" 2>&1 & else "$@" & fi
job=$!
trap 'kill $job 2>/dev/null || true' INT TERM
(
    while sleep 10; do
        kill -0 $job 2>/dev/null || exit 0
        echo "$words: still at it after $SECONDS s"
    done
) &
clock=$!
status=0
wait $job || status=$?
kill $clock 2>/dev/null || true
exit $status
