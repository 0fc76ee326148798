#!/bin/sh
# Install Docker's Compose plugin from the first package of this system that has it.
#
# Docker's own repository, Ubuntu and Debian each name the package differently. Debian 12's docker-compose is the old
# version 1, which is not the plugin.

apt-get update -qq || exit
for name in docker-compose-plugin docker-compose-v2 docker-compose; do
    apt-cache policy "$name" | grep -qE "Candidate: ([0-9]+:)?([2-9]|[1-9][0-9])" || continue
    apt-get install --yes --no-install-recommends "$name"
    exit
done
echo "no package of this system brings the Compose plugin" >&2
exit 1
