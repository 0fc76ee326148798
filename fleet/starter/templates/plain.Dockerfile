# A program for a robot. This one prints the time: put yours in its place.
ARG RUN_BASE=debian:bookworm-slim
FROM ${RUN_BASE}
WORKDIR /app
COPY . /app
CMD ["sh", "-c", "while :; do date; sleep 10; done"]
