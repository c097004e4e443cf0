#!/bin/sh
# Creates a virtual environment with the packages of the Python examples, unless it exists: `sh venv.sh DIR`.
set -eu
python="$1/bin/python"
if "$python" -c 'import iceoryx2, numpy' 2>/dev/null; then exit 0; fi
python3 -m venv "$1"
"$python" -m pip install --quiet --disable-pip-version-check --retries 1 --timeout 10 iceoryx2==0.10.0 numpy
"$python" -c 'import iceoryx2, numpy'
