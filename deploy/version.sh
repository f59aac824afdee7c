#!/usr/bin/env bash
# Prints the version of this tree for what is built of it: that of its tag; after it with the number of commits since then
# and the commit, such as 0.1.0+12.g1a2b3c4, which is newer for pip and for dpkg. Without Git: that of pyproject.toml.
#
#   deploy/version.sh                 prints it
#   deploy/version.sh write FOLDER    writes it into the sources in FOLDER
set -euo pipefail
here=$(cd "$(dirname "$0")/.." && pwd)
base=$(sed -n 's/^version = "\(.*\)"/\1/p' "$here/pyproject.toml")

described() {
    # The tree's own repository only: not one around a source archive.
    [ -e "$here/.git" ] && commit=$(git -C "$here" rev-parse --short=7 HEAD 2>/dev/null) || { echo "$base"; return; }
    if tag=$(git -C "$here" describe --tags --abbrev=0 --match "v$base" 2>/dev/null); then
        since=$(git -C "$here" rev-list --count "$tag..HEAD")
    else
        since=$(git -C "$here" rev-list --count HEAD)
    fi
    dirty=
    git -C "$here" diff --quiet HEAD -- 2>/dev/null || dirty=.dirty
    if [ "$since" = 0 ] && [ -z "$dirty" ]; then echo "$base"; else echo "$base+$since.g$commit$dirty"; fi
}

version=$(described)
if [ "${1:-}" = write ]; then
    sed -i "s/^version = \".*\"/version = \"$version\"/" "$2/pyproject.toml" "$2/deploy/simulators/pyproject.toml"
else
    echo "$version"
fi
