//! Writes the golden messages that the tests of Rust and Python read: `cargo run -p egp-wire --example golden`.

use egp_testing::messages;

fn main() -> std::io::Result<()> {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/golden");
    std::fs::create_dir_all(folder)?;
    for (name, bytes) in messages::all() {
        std::fs::write(format!("{folder}/{name}.bin"), bytes)?;
    }
    Ok(())
}
