//! Compiles the protos in pure Rust: no protoc is needed.
fn main() -> Result<(), Box<dyn std::error::Error>> {
    println!("cargo:rerun-if-changed=proto");
    let files = protox::compile(["proto/sandgait/v1/sandgait.proto", "proto/sandgait/v1/studies.proto"], ["proto"])?;
    tonic_prost_build::configure().bytes(".sandgait.v1").compile_fds(files)?;
    Ok(())
}
