#!/usr/bin/env bash
# Runs the commands at the head of docs/results/NAME.txt again and keeps what the last of them prints. The pages quote these
# files, and tests compare them with the pages and with the calibrations that are shipped. INDEX.csv is that of the labelled
# recordings.
#
#   bash tests/results.sh INDEX.csv NAME...
set -euo pipefail

# A plant's tag becomes the number of its place among all tags of the index; columns keep their places.
neutral() {
    python3 -c '
import re, sys
TAG = r"plant/(\S*?[A-Z]{2,}\d+[A-Z]?)(?=_\d)"
text = sys.stdin.read()
for number, tag in enumerate(sorted(set(re.findall(TAG, open(sys.argv[1]).read()))), 1):
    name = f"valve-{number}"
    spaces = " " * max(0, len(tag) - len(name))
    text = re.sub(rf"(plant/){re.escape(tag)}(?=_\d)(\S*)", lambda m: m[1] + name + m[2] + spaces, text)
sys.stdout.write(text)' "$1"
}

index=$1
shift
for name in "$@"; do
    file=docs/results/$name.txt
    commands=$(sed -n 's/^\$ //p' "$file")
    {
        sed -n '/^\$ /p' "$file"
        while read -r line; do
            read -r -a words <<< "${line//INDEX.csv/$index}"
            printed=$("${words[@]}")
        done <<< "$commands"
        printf '%s\n' "$printed" | neutral "$index"
        # The last line of `stictiond` and `stiction-lab` names the build; what another program prints is of the one on the path.
        grep -q '^build: ' <<< "$printed" || stiction-lab evaluate --simulated 1 | tail -1
        printf 'commit %s, %s\n' "$(git rev-parse --short=8 HEAD)" "$(date +%F)"
    } > "$file.new"
    mv "$file.new" "$file"
done
