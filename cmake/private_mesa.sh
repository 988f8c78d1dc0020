#!/bin/sh
# private_mesa.sh FOLDER: puts the Vulkan driver of Debian 12's backports, whose lavapipe has ray queries, into FOLDER and
# prints the path of its ICD file. Nothing is installed and the system's own driver is not touched. The mirror is the one
# the machine's own apt sources name. When it cannot be had, the last line on stderr says why and the status is 1.
set -eu

give_up() {
    echo "$*" >&2
    exit 1
}

[ $# -eq 1 ] || give_up "usage: private_mesa.sh FOLDER"
mkdir -p "$1"
folder=$(cd "$1" && pwd)
icd="$folder/lvp_icd.json"
if [ -f "$icd" ]; then
    echo "$icd"
    exit 0
fi

codename=$(. /etc/os-release 2>/dev/null && echo "${VERSION_CODENAME-}") || true
[ "$codename" = bookworm ] || give_up "the backports are for Debian 12, this is ${codename:-another system}"
suite=bookworm-backports

# Sources in both notations: lines of *.list, paragraphs of *.sources. Only those for this release itself are taken over,
# with their options and keys.
mkdir -p "$folder/sources" "$folder/lists/partial" "$folder/cache/archives/partial" "$folder/root"
sources=/etc/apt
cat "$sources/sources.list" "$sources"/sources.list.d/*.list 2>/dev/null |
    sed -nE "s/^[[:space:]]*deb([[:space:]]+\[[^]]*\])?[[:space:]]+([^[:space:]]+)[[:space:]]+${codename}[[:space:]].*/deb\1 \2 $suite main/p" \
        >"$folder/sources/backports.list"
for file in "$sources"/sources.list.d/*.sources; do
    [ ! -f "$file" ] || awk -v RS= -v codename="$codename" -v suite="$suite" '
        {
            n = split($0, line, "\n"); deb = ours = disabled = 0; text = ""
            for (i = 1; i <= n; i++) {
                if (line[i] ~ /^#/) continue
                if (line[i] ~ /^Types:.*deb([ \t]|$)/) deb = 1
                if (tolower(line[i]) ~ /^enabled:[ \t]*(no|false|0)/) disabled = 1
                if (line[i] ~ /^Suites:/) {
                    if ((line[i] " ") ~ ("[ \t]" codename "[ \t]")) ours = 1
                    line[i] = "Suites: " suite
                }
                if (line[i] ~ /^Components:/) line[i] = "Components: main"
                if (line[i] ~ /^Types:/) line[i] = "Types: deb"
                text = text line[i] "\n"
            }
            if (deb && ours && !disabled) printf "%s\n", text
        }' "$file"
done >"$folder/sources/backports.sources"
[ -s "$folder/sources/backports.list" ] || [ -s "$folder/sources/backports.sources" ] ||
    give_up "the apt sources of this machine name no mirror of $codename"

apt() {
    apt-get -q -o Dir::Etc::SourceList=/dev/null -o Dir::Etc::SourceParts="$folder/sources" \
        -o Dir::Etc::PreferencesParts=/dev/null -o Dir::State::Lists="$folder/lists" -o Dir::Cache="$folder/cache" \
        -o Debug::NoLocking=true -o APT::Sandbox::User=root "$@" >&2
}

cd "$folder"
apt update || give_up "the mirror of this machine has no $suite"
rm -f mesa-vulkan-drivers_*.deb
apt download -t "$suite" mesa-vulkan-drivers || give_up "mesa-vulkan-drivers of $suite could not be downloaded"
dpkg -x mesa-vulkan-drivers_*.deb root
rm -rf lists cache mesa-vulkan-drivers_*.deb

driver=$(find "$folder/root" -name libvulkan_lvp.so | head -n 1)
manifest=$(find "$folder/root" -name 'lvp_icd*.json' | head -n 1)
[ -n "$driver" ] && [ -n "$manifest" ] || give_up "the package holds no lavapipe driver"
missing=$(ldd "$driver" | awk '/not found/ { print $1 }')
[ -z "$missing" ] || give_up "that lavapipe needs libraries this system lacks: $missing"
sed "s|\"library_path\": *\"[^\"]*\"|\"library_path\": \"$driver\"|" "$manifest" >"$icd.part"
mv "$icd.part" "$icd"
echo "$icd"
