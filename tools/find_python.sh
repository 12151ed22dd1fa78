#!/bin/sh
# Prints the first Python that starts, of the versions given (default: 3.13, then 3.11); exit 1
# where there is none.  A pyenv shim of a version that is not selected does not start, so the
# versions that pyenv has are looked through too.
set -u
[ $# -gt 0 ] || set -- 3.13 3.11
for version; do
    for python in "python$version" "${PYENV_ROOT:-$HOME/.pyenv}/versions/$version".*/bin/python3; do
        if "$python" -c "import sys; sys.exit('%d.%d' % sys.version_info[:2] != '$version')" \
            2>/dev/null; then
            command -v "$python"
            exit
        fi
    done
done
echo "No Python $* here: install one (3.13 for Blender 5.2, 3.11 for Blender 4.5)" >&2
exit 1
