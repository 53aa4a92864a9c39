#!/bin/bash
# Installs a wheel on a Debian that has nothing but Python, and refines a sample there, as a new user would:
#
#     packaging/clean_machine.sh dist/genmf_mi-0.1.0-py3-none-any.whl [bookworm|trixie] [pip|uv] [llvm|nollvm|wheel]
#
# Needs debootstrap and root. What is printed after a $ is what is run in there. `nollvm` stops where LLVM is missing;
# `wheel` takes it from the extra `llvm` in place of Debian's package. MACHINE=DIR keeps the machine and uses it again.
set -euo pipefail
wheel=$(realpath "$1") suite=${2:-bookworm} installer=${3:-pip} llvm=${4:-llvm}
root=${MACHINE:-$(mktemp -d)}
[ -n "${MACHINE:-}" ] || trap 'rm -rf --one-file-system "$root"' EXIT
if [ ! -x "$root/usr/bin/python3" ]; then
    debootstrap --variant=minbase --include=python3,python3-venv,ca-certificates "$suite" "$root" > "$root.log"
fi
cp "$wheel" "$root/root/"
cp /etc/resolv.conf "$root/etc/"                                       # the network and the certificates of this
cp /etc/ssl/certs/ca-certificates.crt "$root/etc/ssl/certs/"           # machine, and its folder of wheels if it has one
export PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin HOME=/root LANG=C.UTF-8 DEBIAN_FRONTEND=noninteractive
unset PYTHONPATH VIRTUAL_ENV GENMF_CACHE GENMF_LPIPS_WEIGHTS
file=$(basename "$wheel") links=${PIP_FIND_LINKS:-}
steps='cd; echo "$(. /etc/os-release; echo $PRETTY_NAME), $(python3 --version), nothing else"'
say() { steps="$steps
echo '\$ $1'
$1"; }
[ "$llvm" = llvm ] && say "apt-get install -qq -y --no-install-recommends libllvm19 libatomic1 libgl1 libopengl0 libcom-err2 > /dev/null"
extra=; [ "$llvm" = wheel ] && extra='[llvm]'
say "python3 -m venv env"
if [ "$installer" = uv ]; then
    say "env/bin/pip install -q uv"
    genmf="env/bin/uvx --from ./$file$extra genmf-mi"
else
    say "env/bin/pip install -q ./$file$extra"
    genmf="env/bin/genmf-mi"
fi
say "$genmf --version"
if [ "$llvm" = nollvm ]; then
    say "$genmf refine ball --preset draft || true"
else
    say "$genmf weights"
    steps="$steps
start=\$(date +%s)"
    say "$genmf refine ball --preset draft --force"
    steps="$steps
echo \"first refinement: \$((\$(date +%s) - start)) s\""
    say "$genmf doctor"
fi
unshare --mount --fork bash -c "
    mount --bind /dev '$root/dev'; mount -t proc proc '$root/proc'
    if [ -d '$links' ]; then mkdir -p '$root$links'; mount --bind '$links' '$root$links'; fi
    chroot '$root' apt-get update -qq
    chroot '$root' bash -e -c \"\$1\"" - "$steps"
