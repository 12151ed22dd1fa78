#!/bin/sh
# Makes or refreshes the virtual environment VENV with this package (editable), Blender's wheel and
# what the tests need; does nothing where it is already as pyproject.toml says.
#   make_venv.sh VENV [PYTHON]
set -eu
venv=$1
python=${2:-}
root=$(cd "$(dirname "$0")/.." && pwd)
[ -n "$python" ] || python=$("$root/tools/find_python.sh")
if ! "$python" -c 'import sys; sys.exit(sys.version_info[:2] not in {(3, 11), (3, 13)})'; then
    echo "$python is no Python 3.13 or 3.11: Blender's wheels are for these" >&2
    exit 2
fi
"$root/tools/system_packages.sh" "$python"

key=$({ "$python" --version && echo "$root" && cat "$root/pyproject.toml"; } | sha256sum)
stamp=$venv/installed
if [ -f "$stamp" ] && [ "$(cat "$stamp")" = "$key" ]; then
    exit
fi
echo "Installing Blender's wheel and the rest into $venv (about 1 GB, a minute or two)"
rm -f "$stamp"
"$python" -m venv --clear "$venv"
"$venv/bin/pip" install --quiet --disable-pip-version-check --editable "$root[test]"
echo "$key" >"$stamp"
