#!/usr/bin/env bash
# Runs the commands at the head of docs/results/NAME.txt again and keeps what the last of them prints. The pages quote these
# files, and a test compares them. INDEX.csv is that of the labelled recordings. Tags of plants become numbers.
#
#   bash tests/results.sh INDEX.csv NAME...
set -euo pipefail

neutral() {
    python3 -c '
import re, sys
text = sys.stdin.read()
for number, tag in enumerate(sorted(set(re.findall(r"plant/(\S*?FIC\d+)", text))), 1):
    name = f"valve-{number}"
    spaces = " " * (len(tag) - len(name))
    text = re.sub(rf"(plant/){re.escape(tag)}(\S*)", lambda m: m[1] + name + m[2] + spaces, text)
sys.stdout.write(text)'
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
        printf '%s\n' "$printed" | neutral
    } > "$file.new"
    mv "$file.new" "$file"
done
