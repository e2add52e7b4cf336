#!/usr/bin/env bash
# run_containerfile.sh CONTAINERFILE CONTEXT VENV [NAME=VALUE...]: takes the steps of a container file in a virtual environment, where
# nothing builds images: ARG (or the values given here), COPY from the folder CONTEXT, and RUN, in a folder beside the environment that
# stands for WORKDIR. At the end CMD's words go to ENTRYPOINT. FROM and USER are left out, and an instruction it does not know ends it.
set -euo pipefail

file=$(realpath "$1")
context=$(realpath "$2")
venv=$(realpath "$3")
shift 3
root=$venv.root
given=" $* "
words() { tr -d '[]",' <<< "$1"; }
export PATH=$venv/bin:/usr/bin:/bin

entry="" command=""
while read -r instruction rest; do
    case $instruction in
    "" | "#"* | FROM | USER) ;;
    ARG)
        name=${rest%%=*}
        if [[ $given == *" $name="* ]]; then value=${given#* "$name"=}; rest=$name=${value%% *}; fi
        export "${rest?}"
        ;;
    WORKDIR) mkdir -p "$root$rest" && cd "$root$rest" ;;
    COPY)
        rest=${rest% *} # what is copied; it goes to WORKDIR
        (cd "$context" && eval "cp $rest '$OLDPWD'") ;;
    RUN) echo "RUN $rest" && bash -euo pipefail -c "$rest" ;;
    ENTRYPOINT) entry=$(words "$rest") ;;
    CMD) command=$(words "$rest") ;;
    *) echo "$instruction: no instruction that is known here" >&2 && exit 2 ;;
    esac
done < "$file"
exec $entry $command
