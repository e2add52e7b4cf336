#!/usr/bin/env bash
# second_day.sh WHEEL FOLDER: takes the commands and files of docs/guides/second-day.md in FOLDER, which has to be new, with a release's
# WHEEL; prints the time of each step and how it ended. 150 generated frames of three people play the stranger's own.
#   LIBRARIES=FOLDER   site-packages in which torch and the rest of the extra `train` are, in place of pip's 6 GB
#   OFFLINE=1          takes all libraries from there, and nothing from an index
#   EPOCHS=N           a shorter training than the page's
set -euo pipefail

wheel=$(realpath "$1")
root=$(cd "$(dirname "$0")/.." && pwd)
page=$root/docs/guides/second-day.md
mkdir -p "$(dirname "$2")"
mkdir "$2"
cd "$2"
cp "$wheel" .
TIMEFORMAT="%R %U %S"

# section TITLE KIND: the fenced blocks of a kind in a section of the page
section() {
    awk -v title="## $1" -v fence="\`\`\`$2" '
        /^## / { in_section = $0 == title }
        in_section && $0 == fence { inside = 1; next }
        /^```$/ { inside = 0 }
        inside' "$page"
}

# step NAME COMMAND: runs it in this shell; "NAME wall CPU", and the last line that it printed
step() {
    if { time eval "$2" >said.txt 2>errors.txt </dev/null; } 2>time.txt; then ended=$(sed '/^$/d' said.txt | tail -n 1); else
        printf '%s\nfailed: %s\n' "$2" "$(cat errors.txt)" >&2
        exit 1
    fi
    read -r wall user system <<<"$(tail -n 1 time.txt)"
    cpu=$(awk "BEGIN { print $user + $system }")
    spent=$(awk "BEGIN { print $spent + $cpu }")
    printf '%-22s %6.1f s %7.1f CPU-s   %.40s\n' "$1" "$wall" "$cpu" "${ended:-done}"
}

# steps TITLE: the commands of a section, each a step
steps() {
    local command words
    while read -r -u 3 command; do
        read -ra words <<<"$command"
        name=${words[*]:0:2}
        if [ "$command" = "pip install 'cabinpose[train]'" ] && [ -n "${LIBRARIES:-}" ]; then command=linked; fi
        step "$name" "$command"
    done 3< <(section "$1" console | sed -n 's/^\$ //p')
}

# linked: shows the environment the libraries of another one, behind its own
linked() { echo "$LIBRARIES" > "$(python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')/libraries.pth"; }

# strangers FOLDER: an export as a stranger's frames: COCO's 17 keypoints, names of people, nothing else that is ours
strangers() {
    python - "$1" <<'PY'
import json
import sys
from pathlib import Path

folder = Path(sys.argv[1])
file = folder / "annotations" / "person_keypoints.json"
given = json.loads(file.read_text())
ours = given["categories"][0]["keypoints"]
sides = [f"{side}_{part}" for part in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle") for side in ("left", "right")]
names = ["nose", "left_eye", "right_eye", "left_ear", "right_ear", *sides]
people = {"S01": "anna", "S02": "bob", "S03": "cleo"}


def keypoints(flat):
    for name in names:
        side, _, part = name.partition("_")
        ours_name = side[0] + {"hip": "pelvis"}.get(part, part)
        at = 3 * ours.index(ours_name) if ours_name in ours else None
        yield from [0, 0, 0] if at is None else flat[at : at + 3]


first = given["images"][0]
(fx, _, cx), (_, fy, cy), _ = first["camera_k"]
camera = {"width": first["width"], "height": first["height"], "fx": fx, "fy": fy, "cx": cx, "cy": cy, "dist": first["camera_dist"]}
(folder / "calibration.yaml").write_text(json.dumps(camera))
images = [{key: image[key] for key in ("id", "file_name", "width", "height")} for image in given["images"]]
annotations = [
    {key: person[key] for key in ("id", "image_id", "category_id", "iscrowd", "bbox", "area")}
    | {"subject": people[person["subject"]], "keypoints": list(keypoints(person["keypoints"]))}
    for person in given["annotations"]
]
category = {"id": 1, "name": "person", "keypoints": names}
file.write_text(json.dumps({"images": images, "annotations": annotations, "categories": [category]}))
PY
}

spent=0
begin=$(date +%s.%N)
if [ -n "${OFFLINE:-}" ]; then export PIP_NO_INDEX=1 PIP_NO_DEPS=1; fi
steps Install
if [ -n "${OFFLINE:-}" ]; then linked; fi
section "Your camera" yaml > my-camera.yaml
spent=0
steps "Your camera"
picture=$(awk "BEGIN { print $(date +%s.%N) - $begin }")
after=$spent
test -s look-view/index.html
printf 'the first own picture after %.0f s with the installation (at most 60), %.1f CPU-s of them after it (at most 15)\n' "$picture" "$after"

{
    cabinpose synth --frames 150 --seed 5 --out theirs "scene.cars=[suv]" "scene.right_hand_drive=0" \
        "people.subjects=[S01, S02, S03]" "scene.occupancy={driver: 1}"
    cabinpose export coco theirs --images depth16 --out my-frames
    strangers my-frames
} >said.txt 2>errors.txt || { cat errors.txt >&2; exit 1; }

section "Your frames" yaml | sed "s/^epochs: .*/epochs: ${EPOCHS:-30}/" > own.yaml
steps "Your frames"
grep -E "^(PCKh@0.5 2D|median error)" said.txt
test -s mine.onnx
test -s report/index.html
awk -v spent="$after" 'BEGIN { exit spent > 15 }'
