#!/bin/sh
# Usage: cross-install.sh [--development] [--keys FILE] ARCHITECTURE BASE TARGET PACKAGE...
#
# Unpacks Debian packages of any architecture, and what they depend on, into the directory TARGET, without running
# anything of that architecture. BASE holds etc/os-release and var/lib/dpkg/status of the image that TARGET will be
# laid over: what that image has already is not fetched again. Its etc/apt says where packages come from, if it is
# there. Maintainer scripts do not run; what matters of them is done here: byte-compiling, alternatives, certificates.
#
# --development: TARGET is a sysroot, which holds BASE already. Headers stay, and TARGET/unpacked/PACKAGE lists the files.
# --keys FILE: more packages, as dependencies of package.xml; catkin_packages.py knows what Debian calls them.
set -eu
development='' keys=''
while :; do
    case $1 in
        --development) development=yes ;;
        --keys)
            keys=$2
            shift
            ;;
        *) break ;;
    esac
    shift
done
architecture=$1 base=$2 target=$3
shift 3

fail() {
    echo "cross-install: $*" >&2
    exit 1
}

release() { sed -n 's/^VERSION_CODENAME=//p' "$1"; }
[ "$(release /etc/os-release)" = "$(release "$base/etc/os-release")" ] ||
    fail "BUILD_BASE and RUN_BASE must be the same Debian release"
has=$(sed -n '/^Package: dpkg$/,/^$/s/^Architecture: //p' "$base/var/lib/dpkg/status")
[ "$has" = "$architecture" ] ||
    fail "the base is for $has, and the image is for $architecture. Cure: name a base of that architecture"

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
sources=/etc/apt
if [ -d "$base/etc/apt" ]; then
    sources=$base/etc/apt
    echo "Dir::Etc \"$sources\";" >>"$work/apt.conf"
fi
export APT_CONFIG="$work/apt.conf"
# A mirror that is being renewed may contradict itself for a while, in practice in the security suite only.
if ! apt-get -q update 2>"$work/problems"; then
    cat "$work/problems" >&2
    grep -q 'unexpected size' "$work/problems" || exit 1
    echo 'cross-install: going on without the security suite' >&2
    cat "$sources/sources.list" "$sources"/sources.list.d/*.list 2>/dev/null | grep -v security >"$work/sources.list"
    printf 'Dir::Etc::SourceList "%s";\nDir::Etc::SourceParts "-";\n' "$work/sources.list" >>"$APT_CONFIG"
    apt-get -q update
fi
named=
if [ -n "$keys" ]; then
    # What it prints is a list of packages, or the sentence why there is none.
    named=$(python3 /catkin_packages.py names "$keys") || {
        echo "$named"
        exit 1
    }
fi
# One word per package.
# shellcheck disable=SC2086
apt-get -q --yes --download-only install "$@" $named

# On merged /usr a package's ./lib/... belongs to /usr/lib.
mkdir -p "$target/usr/bin" "$target/usr/sbin" "$target/usr/lib" "$target/var/lib/dpkg/status.d" "$target/unpacked"
for directory in bin sbin lib; do
    [ -e "$target/$directory" ] || ln -s "usr/$directory" "$target/$directory"
done
headers='./usr/include/*'
if [ -n "$development" ]; then headers=./; fi # a pattern that no member has: all of them are kept
for package in "$work"/archives/*.deb; do
    [ -e "$package" ] || continue
    name=$(dpkg-deb --field "$package" Package)
    dpkg-deb --fsys-tarfile "$package" | tar --extract --verbose --keep-directory-symlink --directory "$target" \
        --exclude './usr/share/man/*' --exclude './usr/share/info/*' --exclude './usr/share/lintian/*' \
        --exclude './usr/share/locale/*' --exclude "$headers" >"$target/unpacked/$name"
    # Where scanners look for packages that dpkg did not configure itself.
    dpkg-deb --field "$package" >"$target/var/lib/dpkg/status.d/$name"
done

# What `update-alternatives --install LINK NAME PATH PRIORITY --slave LINK NAME PATH` would link, the highest priority first:
# libblas.so.3 and liblapack.so.3 have no other name. A link that is there stays.
for package in "$work"/archives/*.deb; do
    [ -e "$package" ] || continue
    dpkg-deb --info "$package" postinst 2>/dev/null |
        sed -e ':join' -e '/\\$/{' -e N -e 's/\\\n/ /' -e 'b join' -e '}' |
        awk '/update-alternatives .*--install/ {
            for (i = 1; i <= NF; i++) {
                if ($i == "--install") priority = $(i + 4)
                if ($i == "--install" || $i == "--slave") print priority, $(i + 1), $(i + 3)
            }
        }'
done | sort -rn | while read -r _ link path; do
    if [ -e "$target$path" ] && [ ! -e "$target$link" ] && [ ! -L "$target$link" ]; then
        mkdir -p "$target${link%/*}"
        ln -s --relative "$target$path" "$target$link"
    fi
done
# What update-ca-certificates collects. Without it, no program trusts a server.
authorities=$target/etc/ssl/certs/ca-certificates.crt
if [ -d "$target/usr/share/ca-certificates" ] && [ ! -e "$authorities" ]; then
    mkdir -p "${authorities%/*}"
    find "$target/usr/share/ca-certificates" -name '*.crt' | sort | xargs cat >"$authorities"
fi
rm -rf "$work"
if [ -n "$development" ]; then
    rm -f "$work.began"
    exit
fi
rm -rf "$target/unpacked" "${target:?}/bin" "${target:?}/sbin" "${target:?}/lib"
find "$target/usr/share/doc" -not -type d -not -name copyright -delete
find "$target" -mindepth 1 -type d -empty -delete
python3 -m compileall -q -j 0 -s "$target" -p / "$target"/usr/lib/python3*
# What the packages do not date would be dated now, and make every build another layer.
find "$target" -newer "$work.began" -exec touch --no-dereference --date=@0 {} +
rm -f "$work.began"
