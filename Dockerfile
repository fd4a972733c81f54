# An image with the server only: docker build -t sandgait . && docker run -p 50051:50051 -v keys:/keys sandgait serve --listen 0.0.0.0:50051 \
#   --tls-cert /keys/cert.pem --tls-key /keys/key.pem --token-file /keys/token
FROM rust:1.95-slim AS build
WORKDIR /build
COPY . .
RUN cargo build --release --locked --bin sandgait

FROM debian:stable-slim
COPY --from=build /build/target/release/sandgait /usr/local/bin/sandgait
COPY LICENSE /usr/share/doc/sandgait/LICENSE
RUN useradd --system --create-home sandgait
USER sandgait
EXPOSE 50051
ENTRYPOINT ["sandgait"]
CMD ["--help"]
