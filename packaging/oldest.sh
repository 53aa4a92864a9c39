#!/bin/bash
# Installs the oldest versions that setup.cfg allows, and refines a sample with them:
#
#     packaging/oldest.sh [PYTHON]
#
# Needs uv, and LLVM. Only what setup.cfg names itself is old; what those packages need in turn is new.
set -euo pipefail
cd "$(dirname "$0")/.."
python=${1:-3.11} folder=$(mktemp -d) links=${PIP_FIND_LINKS:+--find-links $PIP_FIND_LINKS}
trap 'rm -rf "$folder"' EXIT
uv venv -q -p "$python" "$folder/env"
uv pip install -q --python "$folder/env/bin/python" --resolution lowest-direct $links .
uv pip list -q --python "$folder/env/bin/python"
cd "$folder"
env/bin/genmf-mi refine ball --preset draft --iterations 20
