#!/bin/sh
# Makes sure of the Debian packages that Blender's wheel needs: root installs what is missing,
# anyone else gets the one line that does, and exit code 2.
# With "browser" it wants Chromium too, in which the viewer is tested.
#   system_packages.sh PYTHON [browser]
set -eu
command -v apt-get >/dev/null || exit 0 # not Debian: Blender's wheel will say what it misses
python=$1
missing=
libraries=$(PATH=$PATH:/sbin:/usr/sbin ldconfig -p)

need() { # LIBRARY PACKAGE
    case "$libraries" in *"$1 "*) ;; *) missing="$missing $2" ;; esac
}

need libX11.so.6 libx11-6
need libXrender.so.1 libxrender1
need libXfixes.so.3 libxfixes3
need libXi.so.6 libxi6
need libxkbcommon.so.0 libxkbcommon0
need libSM.so.6 libsm6
need libGL.so.1 libgl1
need libEGL.so.1 libegl1 # without it EEVEE aborts the process
need libEGL_mesa.so.0 libegl-mesa0
need libgomp.so.1 libgomp1
need libXxf86vm.so.1 libxxf86vm1

"$python" -c 'import ensurepip, venv' 2>/dev/null ||
    missing="$missing $("$python" -c 'import sys; print("python%d.%d-venv" % sys.version_info[:2])')"

if [ "${2:-}" = browser ] && ! command -v chromium >/dev/null; then
    missing="$missing chromium"
fi

[ -n "$missing" ] || exit 0
install="apt-get install -y --no-install-recommends$missing"
if [ "$(id -u)" -ne 0 ]; then
    echo "Some system packages are missing. Run this, then start again:" >&2
    echo "    sudo $install" >&2
    exit 2
fi
apt-get update -qq
DEBIAN_FRONTEND=noninteractive $install
