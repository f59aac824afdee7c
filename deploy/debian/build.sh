#!/usr/bin/env bash
# Builds talc-gateway_VERSION_ARCH.deb for this computer's Debian release, and talc-gateway-report_VERSION_ARCH.deb with
# the libraries of the report's charts.
#
#   deploy/debian/build.sh [FOLDER]              default: dist
#   ARCH=arm64 deploy/debian/build.sh [FOLDER]   for a Pi, on another computer
#
# LEVEL: how much zstd compresses, 1 to 19 (default: 19, which takes a minute longer than 3 and saves a fifth).
# Everything comes from the locks in requirements/, by hash, what builds the kernel too; nothing is fetched when the
# package is installed. Needs: /usr/bin/python3 (Debian's, whose version the package then depends on), its headers
# (python3-dev), a C++ compiler, dpkg-deb, and PYTHON: any Python with pip (default: python3). For another architecture
# also g++-aarch64-linux-gnu, and libpython3-dev:arm64, here or in the Debian below ARM64_ROOT.
set -euo pipefail
cd "$(dirname "$0")/../.."

output=$(realpath -m "${1:-dist}")
python=$(command -v "${PYTHON:-python3}")
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
umask 022
: "${SOURCE_DATE_EPOCH:=$(git log -1 --format=%ct 2>/dev/null || stat -c %Y pyproject.toml)}"
export SOURCE_DATE_EPOCH PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_ROOT_USER_ACTION=ignore

version=$(deploy/version.sh)
native=$(dpkg --print-architecture)
architecture=${ARCH:-$native}
cross=()
minor=$(/usr/bin/python3 -c 'import sys; print(f"{sys.version_info[0]}.{sys.version_info[1]}")')
next=$(/usr/bin/python3 -c 'import sys; print(f"{sys.version_info[0]}.{sys.version_info[1] + 1}")')
root=$work/root home=/opt/talc-gateway report=$work/report strip=strip

if [ "$architecture" != "$native" ]; then
    [ "$architecture" = arm64 ] || { echo "$0: cannot build for $architecture here" >&2; exit 2; }
    strip=aarch64-linux-gnu-strip
    # States what scikit-build-core and nanobind would take from the target's Python.
    cross=(CXX=aarch64-linux-gnu-g++ "CXXFLAGS=${ARM64_ROOT:+-idirafter $ARM64_ROOT/usr/include}"
        _PYTHON_HOST_PLATFORM=linux-aarch64 "SETUPTOOLS_EXT_SUFFIX=.cpython-${minor/./}-aarch64-linux-gnu.so")
fi

echo "the kernel's wheel"
/usr/bin/python3 -m venv --without-pip "$work/build"
"$python" -m pip --python "$work/build/bin/python" install --quiet --no-compile \
    --require-hashes -r requirements/build.lock
mkdir "$work/source"  # a copy: an editable installation uses the tree's own build folder
tar --exclude=./.git --exclude='./.[a-z]*' --exclude=./build --exclude=./dist --exclude=./out --exclude='*.so' -c . |
    tar -x -C "$work/source"
deploy/version.sh write "$work/source"
env "PATH=$work/build/bin:$PATH" "${cross[@]}" "$python" -m pip --python "$work/build/bin/python" wheel --quiet --no-deps \
    --no-build-isolation --wheel-dir "$work" "$work/source" "$work/source/deploy/simulators"

echo "the environment in $home"
mkdir -p "$root$home"
/usr/bin/python3 -m venv --without-pip "$root$home"
site=$root$home/lib/python$minor/site-packages
into=("$python" -m pip --python "$root$home/bin/python" install --quiet --no-compile)
if [ "$architecture" != "$native" ]; then
    into+=(--target "$site" --upgrade --only-binary :all: --platform linux_aarch64 --platform manylinux2014_aarch64)
    for glibc in 17 24 26 27 28 31 34 35; do into+=(--platform "manylinux_2_${glibc}_aarch64"); done
fi
"${into[@]}" --require-hashes -r requirements/run.lock
"${into[@]}" --no-deps --no-index "$work"/talc_gateway*.whl
if [ -d "$site/bin" ]; then
    mv "$site/bin"/* "$root$home/bin/"
    rmdir "$site/bin"
fi
# An environment knows where it is: it will be in $home, not below the folder in which it was made.
grep -rlIF "$root" "$root$home/bin" "$root$home/pyvenv.cfg" | xargs -r sed -i "s#$root##g"
find "$root$home" -name direct_url.json -delete
# What nobody runs there: the libraries' own tests, what compilers and type checkers read, tools to build packages (osqp
# names setuptools, for code that it generates), rich's highlighting and Markdown, and symbols. `strip` spoils what
# patchelf has given a path to libraries.
find "$site" -depth -type d \( -name tests -o -name test \) -exec rm -r {} +
find "$site" -type f \( -name '*.pyi' -o -name '*.py[xd]' -o -name '*.a' -o -name '*.[ch]' -o -name '*.[ch]pp' \) -delete
rm -r "$site"/{setuptools,setuptools-*.dist-info,_distutils_hack,distutils-precedence.pth}
rm -r "$site"/{pygments,markdown_it,mdurl} "$site"/{pygments,markdown_it_py,mdurl}-*.dist-info
rm -f "$root$home"/bin/{pygmentize,markdown-it}  # absent for arm64: pip leaves the scripts of the last call alone
for each in "$site"/scipy.libs/*; do  # both wheels bring the same ones
    ! cmp --quiet "$each" "$site/numpy.libs/${each##*/}" || ln -sf "../numpy.libs/${each##*/}" "$each"
done
find "$site" -name '*.so' -not -path '*.libs/*' | while read -r each; do
    readelf -d "$each" | grep -Eq 'RPATH|RUNPATH' || "$strip" --strip-unneeded "$each"
done
"$python" deploy/debian/apart.py "$site" "$report$home/lib/python$minor/site-packages"
# Compiled here, and never checked against the time: nobody writes below $home later.
for part in "$root" "$report"; do
    "$root$home/bin/python" -m compileall -q -j 2 -s "$part" --invalidation-mode unchecked-hash \
        "$part$home/lib" >/dev/null || true  # a file for another Python in a package's data
done

echo "the package"
mkdir -p "$root/usr/lib/systemd/system" "$root/usr/share/doc/talc-gateway"
cp -r deploy/systemd/. "$root/usr/lib/systemd/system/"
cp LICENSE CHANGELOG.md README.md SECURITY.md "$root/usr/share/doc/talc-gateway/"
# As in the source tree, so that the names in messages and the links between pages lead to them; pictures are left out.
tar --exclude='*.png' --exclude='*.webp' --exclude='*.ipynb' --exclude=__pycache__ -c docs examples | tar -x -C "$root/usr/share/doc/talc-gateway"
mkdir -p "$root$home/share"
cp -r deploy/{ansible,grafana,nc,pi,prometheus,zenoh} "$root$home/share/"
install -m 644 deploy/debian/gateway.toml "$root$home/share/gateway.toml"  # postinst copies it: no conffile, so no question
[ "$architecture" != "$native" ] || deploy/debian/linuxcnc_component.sh "$root$home/share/nc/linuxcnc/prebuilt"
/usr/bin/python3 deploy/debian/sbom.py "$site" "$work/build/lib/python$minor/site-packages" \
    "$root/usr/share/doc/talc-gateway"
/usr/bin/python3 deploy/debian/sbom.py "$report$home/lib/python$minor/site-packages" \
    "$work/build/lib/python$minor/site-packages" "$report/usr/share/doc/talc-gateway-report"
mkdir -p "$root/usr/bin" "$root/DEBIAN" "$report/DEBIAN"
ln -s "$home/bin/talc-gateway" "$root/usr/bin/talc-gateway"
reads=$root$home/bin/python
[ "$architecture" = "$native" ] || reads=$python # the target's libraries cannot be imported here
"$reads" deploy/debian/manual.py "$version" "$root/usr/share"
install -m 755 deploy/debian/{preinst,postinst,prerm,postrm} "$root/DEBIAN/"
sed -i "s/@VERSION@/$version/" "$root/DEBIAN/postinst"
echo "$version" >"$root$home/version"
control() {  # folder, package, dependencies and other fields, title; the description follows
    cat >"$1/DEBIAN/control" <<CONTROL
Package: $2
Version: $version
Architecture: $architecture
Maintainer: talc-gateway developers <talc-gateway@localhost>
Section: misc
Priority: optional
Installed-Size: $(du -sk "$1" | cut -f1)
$3
Description: $4
$(cat)
CONTROL
    find "$1" -newermt "@$SOURCE_DATE_EPOCH" -exec touch -h -d "@$SOURCE_DATE_EPOCH" {} +
    dpkg-deb --root-owner-group -Zzstd "-z${LEVEL:-19}" --build "$1" "$output/$2_${version}_$architecture.deb"
}
mkdir -p "$output"
control "$root" talc-gateway "Depends: python3 (>= $minor), python3 (<< $next), libc6, libstdc++6, passwd
Recommends: systemd, chrony
Suggests: talc-gateway-report" "thermal adaptive learning control for five-axis machine tools" <<DESCRIPTION
 Reads temperatures beside a machine tool, learns its thermal errors from probing
 cycles, and corrects them. Brings its own Python environment.
DESCRIPTION
# Replaces: once the libraries were in the other package.
control "$report" talc-gateway-report "Depends: talc-gateway, python3 (>= $minor), python3 (<< $next)
Breaks: talc-gateway (<< $version)
Replaces: talc-gateway (<< $version)" "charts of talc-gateway's report" <<DESCRIPTION
 The libraries with which talc-gateway draws its report and its demo.
DESCRIPTION
