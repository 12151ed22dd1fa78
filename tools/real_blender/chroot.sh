#!/bin/bash
# A real Blender, the program, out of Debian packages in a folder of its own.  Root on Debian only.
#   chroot.sh setup  trixie|sid       once, about 3 minutes and 2 GB
#   chroot.sh run    trixie|sid CMD   run CMD there with a clean environment (DISPLAY passed on)
#   chroot.sh umount trixie|sid       before removing the folder: the host's /tmp is mounted in it
# trixie has Blender 4.3 on Python 3.13, sid Blender 5.2 on Python 3.14.  /tmp is shared, so is X.
set -eu
command=$1
suite=$2
shift 2
home=${REAL_BLENDER_ROOT:-/opt}/$suite
packages="blender python3-numpy python3-requests xvfb xdotool imagemagick
    libgl1-mesa-dri libglx-mesa0 libegl-mesa0 libegl1 libgl1 mesa-vulkan-drivers"

mirror() { # the one that this machine's apt already uses
    apt-get indextargets --format '$(REPO_URI) $(RELEASE) $(COMPONENT)' 'Created-By: Packages' |
        awk -v release="$(. /etc/os-release && echo "$VERSION_CODENAME")" \
            '$2 == release && $3 == "main" { print $1; exit }'
}

mount_all() {
    local folder
    for folder in proc dev dev/pts sys tmp; do
        mountpoint -q "$home/$folder" || mount --bind "/$folder" "$home/$folder"
    done
    ln -sf /proc/self/mounts "$home/etc/mtab" # Blender looks for disks in it
}

inside() {
    exec chroot "$home" env -i HOME=/root PATH=/usr/bin:/bin:/usr/sbin LANG=C.UTF-8 \
        BLENDER_USER_RESOURCES="${BLENDER_USER_RESOURCES:-/tmp/real-blender-$suite}" \
        MESA_SHADER_CACHE_DIR="/tmp/real-blender-mesa-$suite" \
        ${TMPDIR:+TMPDIR=$TMPDIR} ${DISPLAY:+DISPLAY=$DISPLAY} "$@"
}

setup() {
    command -v debootstrap >/dev/null ||
        { apt-get update -qq && apt-get install -y --no-install-recommends debootstrap; }
    [ -x "$home/usr/bin/apt-get" ] || debootstrap --variant=minbase "$suite" "$home" "$(mirror)"
    mount_all
    cp /etc/resolv.conf "$home/etc/resolv.conf"
    cp -n /etc/apt/apt.conf.d/*proxy* "$home/etc/apt/apt.conf.d/" 2>/dev/null || true
    printf '#!/bin/sh\nexit 101\n' >"$home/usr/sbin/policy-rc.d" # start no services
    chmod +x "$home/usr/sbin/policy-rc.d"
    if [ "$suite" = sid ]; then # signatures are checked, the date of a mirror's copy is not
        echo 'Acquire::Check-Valid-Until "false";' >"$home/etc/apt/apt.conf.d/99mirror"
        packages="$packages python3-cattr python3-certifi python3-zstandard"
    fi
    chroot "$home" env DEBIAN_FRONTEND=noninteractive LC_ALL=C sh -c \
        "apt-get update -qq && apt-get install -y --no-install-recommends $(echo $packages)"
}

case $command in
setup) setup ;;
run) mount_all && inside "$@" ;;
umount)
    for folder in tmp sys dev/pts dev proc; do
        ! mountpoint -q "$home/$folder" || umount "$home/$folder"
    done
    ;;
esac
