#!/bin/sh
# Makes a virtual environment with what the Python examples need, unless it is there: `sh venv.sh DIR`.
set -eu
python="$1/bin/python"
if "$python" -c 'import iceoryx2, numpy' 2>/dev/null; then exit 0; fi
python3 -m venv "$1"
"$python" -m pip install --quiet --disable-pip-version-check --retries 1 --timeout 10 iceoryx2==0.10.0 numpy
"$python" -c 'import iceoryx2, numpy'
