#!/bin/sh
# Usage: cross-install.sh ARCHITECTURE BASE TARGET PACKAGE...
#
# Unpacks Debian packages of any architecture, and what they depend on, into the directory TARGET, without running
# anything of that architecture. BASE holds etc/os-release and var/lib/dpkg/status of the image that TARGET will be
# laid over: what that image has already is not fetched again. Maintainer scripts do not run; what matters of them
# for Python packages, the byte-compiling, is done here.
set -eu
architecture=$1 base=$2 target=$3
shift 3

release() { sed -n 's/^VERSION_CODENAME=//p' "$1"; }
if [ "$(release /etc/os-release)" != "$(release "$base/etc/os-release")" ]; then
    echo "cross-install: BUILD_BASE and RUN_BASE must be the same Debian release" >&2
    exit 1
fi

work=$(mktemp -d)
touch "$work.began"
mkdir -p "$work/lists/partial" "$work/archives/partial"
cat >"$work/apt.conf" <<CONF
APT::Architecture "$architecture";
APT::Architectures { "$architecture"; };
APT::Install-Recommends "false";
APT::Sandbox::User "root";
Dir::State::Lists "$work/lists";
Dir::State::Status "$base/var/lib/dpkg/status";
Dir::State::Extended_States "$work/extended_states";
Dir::Cache::Archives "$work/archives";
Dir::Cache::pkgcache "";
Dir::Cache::srcpkgcache "";
DPkg::Post-Invoke {};
APT::Keep-Downloaded-Packages "true";
CONF
export APT_CONFIG="$work/apt.conf"
# A mirror that is being renewed may contradict itself for a while, in practice in the security suite only.
if ! apt-get -q update 2>"$work/problems"; then
    cat "$work/problems" >&2
    grep -q 'unexpected size' "$work/problems" || exit 1
    echo 'cross-install: going on without the security suite' >&2
    cat /etc/apt/sources.list /etc/apt/sources.list.d/*.list 2>/dev/null | grep -v security >"$work/sources.list"
    printf 'Dir::Etc::SourceList "%s";\nDir::Etc::SourceParts "-";\n' "$work/sources.list" >>"$APT_CONFIG"
    apt-get -q update
fi
apt-get -q --yes --download-only install "$@"

# On merged /usr a package's ./lib/... belongs to /usr/lib.
mkdir -p "$target/usr/bin" "$target/usr/sbin" "$target/usr/lib" "$target/var/lib/dpkg/status.d"
for directory in bin sbin lib; do
    ln -s "usr/$directory" "$target/$directory"
done
for package in "$work"/archives/*.deb; do
    dpkg-deb --fsys-tarfile "$package" | tar --extract --keep-directory-symlink --directory "$target" \
        --exclude './usr/share/man/*' --exclude './usr/share/info/*' --exclude './usr/share/lintian/*' \
        --exclude './usr/share/locale/*' --exclude './usr/include/*'
    # Where scanners look for packages that dpkg did not configure itself.
    dpkg-deb --field "$package" >"$target/var/lib/dpkg/status.d/$(dpkg-deb --field "$package" Package)"
done
rm -rf "$work" "${target:?}/bin" "${target:?}/sbin" "${target:?}/lib"
find "$target/usr/share/doc" -not -type d -not -name copyright -delete
find "$target" -mindepth 1 -type d -empty -delete
python3 -m compileall -q -j 0 -s "$target" -p / "$target"/usr/lib/python3*
# What the packages do not date would be dated now, and make every build another layer.
find "$target" -newer "$work.began" -exec touch --no-dereference --date=@0 {} +
rm -f "$work.began"
