#!/usr/bin/env bash
# Builds a wheel of this package for each architecture, for every Python from 3.12 on and every glibc from 2.28 on.
#
#   PYTHON=python3.12 deploy/wheels.sh [FOLDER]    default: dist
#
# PYTHON: 3.12 or later with its headers, pip and venv; with 3.11 the wheels are for 3.11 only. Everything comes from the
# locks in requirements/, by hash: wheels.lock has the compiler, Zig, and abi3audit; build.lock the other tools. Zig
# compiles for x86-64 and for aarch64 on either, and says which glibc it needs; ZIG_FOLDER keeps it for another run. The
# headers are those of PYTHON for both: on 64-bit Linux the limited API depends on nothing else in them.
set -euo pipefail
cd "$(dirname "$0")/.."

output=$(realpath -m "${1:-dist}")
python=$(command -v "${PYTHON:-python3}")
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
: "${SOURCE_DATE_EPOCH:=$(git log -1 --format=%ct 2>/dev/null || stat -c %Y pyproject.toml)}"
export SOURCE_DATE_EPOCH PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_ROOT_USER_ACTION=ignore
minor=$("$python" -c 'import sys; print(sys.version_info[1])')
[ "$minor" -ge 11 ] || { echo "$0: $python is older than 3.11; set PYTHON" >&2; exit 2; }

"$python" -m venv "$work/build"
pip=("$work/build/bin/python" -m pip)
"${pip[@]}" install --quiet --require-hashes -r requirements/build.lock
sed -n '/^ziglang==/,/# via/p' requirements/wheels.lock >"$work/zig.lock"
sed '/^ziglang==/,/# via/d' requirements/wheels.lock >"$work/others.lock"
zig=${ZIG_FOLDER:-$work/zig-program}
[ -x "$zig/ziglang/zig" ] || "${pip[@]}" install --quiet --require-hashes --target "$zig" -r "$work/zig.lock"
# From 3.12 on nanobind has a stable ABI.
[ "$minor" -lt 12 ] || "${pip[@]}" install --quiet --require-hashes -r "$work/others.lock"
mkdir "$work/source" "$work/wheels"  # a copy: an editable installation uses the tree's own build folder
tar --exclude=./.git --exclude='./.[a-z]*' --exclude=./build --exclude=./dist --exclude=./out --exclude='*.so' -c . |
    tar -x -C "$work/source"
deploy/version.sh write "$work/source"
cp "$work/source/pyproject.toml" "$work/pyproject.toml"

for architecture in x86_64 aarch64; do
    printf '#!/bin/sh\nexec "%s" c++ -target %s-linux-gnu.2.28 "$@"\n' "$zig/ziglang/zig" "$architecture" \
        >"$work/zig-$architecture"
    chmod +x "$work/zig-$architecture"
    rm -rf "$work/source/build"
    suffix=.abi3.so
    [ "$minor" -ge 12 ] || suffix=.cpython-311-$architecture-linux-gnu.so
    # States what scikit-build-core and nanobind would take from the target's Python. The name of the platform is not in
    # the environment: without a platform that begins with linux, packaging gives a wheel for 3.11 no ABI in its tag.
    { cat "$work/pyproject.toml"; printf '[tool.scikit-build.env]\n_PYTHON_HOST_PLATFORM = { default = "manylinux_2_28_%s", force = true }\n' \
        "$architecture"; } >"$work/source/pyproject.toml"
    env "PATH=$work/build/bin:$PATH" CXXFLAGS="-include cstdio" CXX="$work/zig-$architecture" ZIG_GLOBAL_CACHE_DIR="${ZIG_GLOBAL_CACHE_DIR:-$work/zig}" \
        _PYTHON_HOST_PLATFORM="linux-$architecture" SETUPTOOLS_EXT_SUFFIX="$suffix" \
        "${pip[@]}" wheel --quiet --no-deps --no-build-isolation --wheel-dir "$work/wheels" "$work/source"
done
[ "$minor" -lt 12 ] || "$work/build/bin/abi3audit" --strict --report "$work"/wheels/*.whl
# The demo's emulated machine: pure Python, one wheel for all.
"${pip[@]}" wheel --quiet --no-deps --no-build-isolation --wheel-dir "$work/wheels" "$work/source/deploy/simulators"
mkdir -p "$output"
mv "$work"/wheels/*.whl "$output/"
