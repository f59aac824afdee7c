#!/bin/sh
# Installs the real-time component talc_errors for the LinuxCNC that is installed here. As root.
#
# Compiles it, or, where halcompile is missing, takes the one that the Debian package brings in the folder `prebuilt`.
# That one is only for the LinuxCNC that it was compiled with; DESTDIR installs it below this folder instead of /.
set -eu
cd "$(dirname "$0")"
if command -v halcompile >/dev/null; then
    halcompile --install talc_errors.comp
    exit
fi
here="$(dpkg --print-architecture) $(dpkg-query -W -f '${Version}' linuxcnc-uspace 2>/dev/null || echo "no linuxcnc-uspace")"
if [ ! -f prebuilt/talc_errors.so ]; then
    echo "halcompile is missing: apt-get install linuxcnc-uspace-dev" >&2
    exit 1
fi
if [ "$here" != "$(cat prebuilt/made-for)" ]; then
    echo "prebuilt/talc_errors.so is for $(cat prebuilt/made-for), here is $here:" \
        "apt-get install linuxcnc-uspace-dev, then run this again to compile it" >&2
    exit 1
fi
install -D -m 644 prebuilt/talc_errors.so "${DESTDIR:-}/usr/lib/linuxcnc/modules/talc_errors.so"
