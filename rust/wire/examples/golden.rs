//! Writes the golden messages that both languages read: `cargo run -p egp-wire --example golden`.

#[path = "../tests/fixtures/mod.rs"]
mod fixtures;

fn main() -> std::io::Result<()> {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/golden");
    std::fs::create_dir_all(folder)?;
    for (name, bytes) in fixtures::all() {
        std::fs::write(format!("{folder}/{name}.bin"), bytes)?;
    }
    Ok(())
}
