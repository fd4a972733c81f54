# An image with the server only: docker build -t sandgait . && docker run -p 50051:50051 -v keys:/keys sandgait serve --listen 0.0.0.0:50051 \
#   --tls-cert /keys/cert.pem --tls-key /keys/key.pem --token-file /keys/token
FROM rust:1.95-slim AS build
WORKDIR /build
COPY . .
RUN apt-get update && apt-get install --yes --no-install-recommends python3
RUN cargo build --release --locked --bin sandgait && python3 .github/notices.py

FROM debian:stable-slim
COPY --from=build /build/target/release/sandgait /usr/local/bin/sandgait
COPY --from=build /build/LICENSE /build/THIRD_PARTY_NOTICES.txt /usr/share/doc/sandgait/
RUN useradd --system --create-home sandgait
USER sandgait
EXPOSE 50051
ENTRYPOINT ["sandgait"]
CMD ["--help"]
