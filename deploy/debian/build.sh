#!/usr/bin/env bash
# Builds talc-gateway_VERSION_ARCH.deb for this computer's Debian release and architecture.
#
#   deploy/debian/build.sh [FOLDER]        default: dist
#
# Everything comes from the locks in requirements/, by hash, what builds the kernel too; nothing is fetched when the
# package is installed. Needs: /usr/bin/python3 (Debian's, whose version the package then depends on), its headers
# (python3-dev), a C++ compiler, dpkg-deb, and PYTHON: any Python with pip (default: python3).
set -euo pipefail
cd "$(dirname "$0")/../.."

output=$(realpath -m "${1:-dist}")
python=$(command -v "${PYTHON:-python3}")
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
umask 022
: "${SOURCE_DATE_EPOCH:=$(git log -1 --format=%ct 2>/dev/null || stat -c %Y pyproject.toml)}"
export SOURCE_DATE_EPOCH PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_ROOT_USER_ACTION=ignore

version=$(sed -n 's/^version = "\(.*\)"/\1/p' pyproject.toml)
architecture=$(dpkg --print-architecture)
minor=$(/usr/bin/python3 -c 'import sys; print(f"{sys.version_info[0]}.{sys.version_info[1]}")')
next=$(/usr/bin/python3 -c 'import sys; print(f"{sys.version_info[0]}.{sys.version_info[1] + 1}")')
root=$work/root home=/opt/talc-gateway

echo "the kernel's wheel"
/usr/bin/python3 -m venv --without-pip "$work/build"
"$python" -m pip --python "$work/build/bin/python" install --quiet --require-hashes -r requirements/build.lock
mkdir "$work/source"  # a copy: an editable installation uses the tree's own build folder
tar --exclude=./.git --exclude='./.[a-z]*' --exclude=./build --exclude=./dist --exclude=./out --exclude='*.so' -c . |
    tar -x -C "$work/source"
PATH="$work/build/bin:$PATH" "$python" -m pip --python "$work/build/bin/python" wheel --quiet --no-deps \
    --no-build-isolation --wheel-dir "$work" "$work/source"

echo "the environment in $home"
mkdir -p "$root$home"
/usr/bin/python3 -m venv --without-pip "$root$home"
into=("$python" -m pip --python "$root$home/bin/python" install --quiet --no-compile)
"${into[@]}" --require-hashes -r requirements/run.lock
"${into[@]}" --no-deps --no-index "$work"/talc_gateway-*.whl
# An environment knows where it is: it will be in $home, not below the folder in which it was made.
grep -rlIF "$root" "$root$home/bin" "$root$home/pyvenv.cfg" | xargs -r sed -i "s#$root##g"
find "$root$home" -name direct_url.json -delete
# Compiled here, and never checked against the time: nobody writes below $home later.
"$root$home/bin/python" -m compileall -q -j 2 -s "$root" -x '/tests?/' --invalidation-mode unchecked-hash \
    "$root$home/lib" >/dev/null || true  # a file for another Python in a package's data

echo "the package"
install -D -m 644 deploy/systemd/talc-gateway.service "$root/usr/lib/systemd/system/talc-gateway.service"
install -D -m 640 deploy/debian/gateway.toml "$root/etc/talc-gateway/gateway.toml"
for page in LICENSE CHANGELOG.md README.md docs/install-pi.md; do
    install -D -m 644 "$page" "$root/usr/share/doc/talc-gateway/$(basename "$page")"
done
for folder in deploy/nc deploy/pi; do
    [ ! -d "$folder" ] || (mkdir -p "$root$home/share" && cp -r "$folder" "$root$home/share/")
done
/usr/bin/python3 deploy/debian/sbom.py "$root$home/lib/python$minor/site-packages" "$root/usr/share/doc/talc-gateway"
mkdir -p "$root/usr/bin" "$root/DEBIAN"
ln -s "$home/bin/talc-gateway" "$root/usr/bin/talc-gateway"
install -m 755 deploy/debian/{postinst,prerm,postrm} "$root/DEBIAN/"
echo /etc/talc-gateway/gateway.toml >"$root/DEBIAN/conffiles"
cat >"$root/DEBIAN/control" <<CONTROL
Package: talc-gateway
Version: $version
Architecture: $architecture
Maintainer: talc-gateway developers <talc-gateway@localhost>
Section: misc
Priority: optional
Installed-Size: $(du -sk "$root" | cut -f1)
Depends: python3 (>= $minor), python3 (<< $next), libc6, libstdc++6, passwd
Recommends: systemd, chrony
Description: thermal adaptive learning control for five-axis machine tools
 Reads temperatures beside a machine tool, learns its thermal errors from probing
 cycles, and corrects them. Brings its own Python environment.
CONTROL
find "$root" -newermt "@$SOURCE_DATE_EPOCH" -exec touch -h -d "@$SOURCE_DATE_EPOCH" {} +
mkdir -p "$output"
dpkg-deb --root-owner-group -Zzstd -z6 --build "$root" "$output/talc-gateway_${version}_$architecture.deb"
