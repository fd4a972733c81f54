# An image with the server only: docker build -t sandgait . (or podman build), then
#   docker run -p 50051:50051 -v ./keys:/keys:ro -v sandgait-state:/state sandgait serve --listen 0.0.0.0:50051 \
#     --tls-cert /keys/cert.pem --tls-key /keys/key.pem --token-file /keys/token --state-dir /state
# All options can also be in a file: serve --config /keys/serve.toml (examples/server/serve.toml).
FROM docker.io/library/rust:1.95-slim AS build
WORKDIR /build
COPY . .
RUN apt-get update && apt-get install --yes --no-install-recommends python3
RUN cargo build --release --locked --bin sandgait && python3 .github/notices.py

FROM docker.io/library/debian:stable-slim
COPY --from=build /build/target/release/sandgait /usr/local/bin/sandgait
COPY --from=build /build/LICENSE /build/THIRD_PARTY_NOTICES.txt /usr/share/doc/sandgait/
RUN useradd --system --uid 10001 --create-home sandgait && install -d -o sandgait -m 700 /state
USER sandgait
# Sessions that the server saves at SIGTERM, with --state-dir /state.
VOLUME /state
EXPOSE 50051
# Does the server accept connections? This needs neither token nor certificate.
HEALTHCHECK --interval=30s --timeout=5s --start-period=10s CMD ["bash", "-c", "exec 3<>/dev/tcp/127.0.0.1/50051"]
STOPSIGNAL SIGTERM
ENTRYPOINT ["sandgait"]
CMD ["--help"]
