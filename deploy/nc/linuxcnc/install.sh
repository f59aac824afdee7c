#!/bin/sh
# Compiles the real-time component talc_errors for the LinuxCNC that is installed here, and installs it. As root.
set -eu
cd "$(dirname "$0")"
if ! command -v halcompile >/dev/null; then
    echo "halcompile is missing: apt-get install linuxcnc-uspace-dev" >&2
    exit 1
fi
halcompile --install talc_errors.comp
