#!/bin/sh
# Compiles LinuxCNC's real-time component for the package, into FOLDER, and notes for which LinuxCNC it is.
#
#   deploy/debian/linuxcnc_component.sh FOLDER
#
# Needs Debian's linuxcnc-uspace and linuxcnc-uspace-dev, in the release and the architecture that the package is for.
# Without them the package brings only the source, which install.sh compiles on the control.
set -eu
cd "$(dirname "$0")/../nc/linuxcnc"
if ! command -v halcompile >/dev/null; then
    echo "without LinuxCNC's component: halcompile is not here (linuxcnc-uspace-dev)" >&2
    exit 0
fi
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cp talc_errors.comp talc_errors.h "$work"
(cd "$work" && halcompile --compile talc_errors.comp >/dev/null)
strip --strip-debug --remove-section=.note.gnu.build-id "$work/talc_errors.so" # the same bytes, wherever it was compiled
mkdir -p "$1"
install -m 644 "$work/talc_errors.so" "$1/talc_errors.so"
echo "$(dpkg --print-architecture) $(dpkg-query -W -f '${Version}' linuxcnc-uspace)" >"$1/made-for"
