#!/bin/sh
# Prove that an image is the one that was sent: by the digest of its configuration.
#
# Arguments: NAME IDENTITY (sha256:..., of its configuration) FINGERPRINT (the name of its receipt)
# In a classic store that is the image's ID. In a containerd store the ID is the manifest's, which names it: the receipt is
# the manifest of an image that came layer by layer; of one that came whole, Docker is asked for it.
set -u
name=$1 identity=$2 receipt=$HOME/.fleet/receipts/$3

id=$(docker image inspect --format '{{.Id}}' "$name") || exit
[ "$id" != "$identity" ] || exit 0
names_it() { grep -q '"config": *{[^}]*"digest": *"'"$identity"'"' "$1"; }
if [ "$(sha256sum <"$receipt" 2>/dev/null | cut -c1-64)" = "${id#sha256:}" ]; then
    ! names_it "$receipt" || exit 0
elif mkdir -p "${receipt%/*}" && docker save "$name" | tar -xOf - "blobs/sha256/${id#sha256:}" >"$receipt.new" 2>/dev/null; then
    if names_it "$receipt.new"; then
        mv -f "$receipt.new" "$receipt"
        exit 0
    fi
    rm -f "$receipt.new"
    # The ID of an index: it has the image for one platform, and what Docker would run is in manifest.json.
    docker save "$name" | tar -xOf - manifest.json 2>/dev/null | grep -q "\"Config\": *\"blobs/sha256/${identity#sha256:}\"" && exit 0
fi
rm -f "$receipt.new"
echo "$name arrived as another image: $id" >&2
exit 1
