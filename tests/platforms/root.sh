# shellcheck shell=bash
# Root file systems of Debian and Ubuntu, below build/: to be sourced. Needs root and the network.

packages=ca-certificates,make,gcc,libc6-dev,python3-dev,python3-venv,python3-gi,gir1.2-aravis-0.8,libusb-1.0-0,systemd
keyring=/usr/share/keyrings/ubuntu-archive-keyring.gpg

# make_root SUITE ROOT [ARCHITECTURE]: as debootstrap makes it, unless it is there.
make_root() {
    local suite=$1 root=$2 architecture=${3:-$(dpkg --print-architecture)} archive components key=
    case $suite in
        bookworm | trixie) archive=http://deb.debian.org/debian components=main ;;
        jammy | noble)
            archive=http://archive.ubuntu.com/ubuntu components=main,universe
            key=--no-check-gpg # Debian has no key of Ubuntu's
            if [ -e $keyring ]; then key=--keyring=$keyring; fi
            ;;
        *) echo "$suite is no suite: give some of bookworm, trixie, jammy, noble" >&2 && return 1 ;;
    esac
    if [ -e "$root/prepared" ]; then return; fi
    rm -rf --one-file-system "$root"
    # In a mount namespace, because it leaves /proc mounted.
    unshare --mount debootstrap "--arch=$architecture" --variant=minbase "--components=$components" \
        "--include=$packages" ${key:+"$key"} "$suite" "$root" "$archive" >"$root.log" ||
        { tail -5 "$root.log" && return 1; }
    touch "$root/prepared"
}

# renew ROOT: the committed sources, and this machine's settings of network and pip.
renew() {
    local root=$1
    cp /etc/resolv.conf "$root/etc/resolv.conf"
    for file in /etc/pip.conf "$HOME/.config/pip/pip.conf" /etc/ssl/certs/ca-certificates.crt; do
        if [ -e "$file" ]; then install -D -m 644 "$file" "$root$file"; fi
    done
    mkdir -p "$root/src"
    find "$root/src" -mindepth 1 -maxdepth 1 ! -name .venv -exec rm -rf {} +
    git archive HEAD | tar -x -C "$root/src"
}

# inside ROOT COMMANDS: in /src, in namespaces of their own, so that no mount and no process is left behind.
inside() {
    # shellcheck disable=SC2016
    unshare --mount --pid --fork --kill-child sh -euc '
        mount -t proc proc "$1/proc"
        mount --rbind /dev "$1/dev"
        exec chroot "$1" /usr/bin/env -C /src bash -euo pipefail -c "$2"' sh "$1" "$2"
}
