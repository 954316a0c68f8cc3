#!/usr/bin/env bash
# Runs the commands at the head of docs/results/NAME.txt again and keeps what the last of them prints. The pages quote these
# files, and a test compares them. INDEX.csv is that of the labelled recordings.
#
#   bash tests/results.sh INDEX.csv NAME...
set -euo pipefail
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
        printf '%s\n' "$printed"
    } > "$file.new"
    mv "$file.new" "$file"
done
