//! Writes the macro `doc!`, by which `help()` shows the same text as an editor: `doc!(Path.length)` is the docstring
//! that the stubs of the extension have for this name.

use std::error::Error;
use std::fmt::Write;
use std::path::Path;
use std::{env, fs};

fn main() -> Result<(), Box<dyn Error>> {
    let stubs = Path::new(&env::var("CARGO_MANIFEST_DIR")?).join("../../python/egp_service/_core");
    println!("cargo::rerun-if-changed={}", stubs.display());
    let mut arms = String::new();
    for entry in fs::read_dir(&stubs)? {
        let path = entry?.path();
        if path.extension().is_some_and(|extension| extension == "pyi") {
            for (name, text) in docstrings(&fs::read_to_string(path)?) {
                write!(arms, "({name}) => {{ {text:?} }};")?;
            }
        }
    }
    let macro_file = Path::new(&env::var("OUT_DIR")?).join("doc.rs");
    Ok(fs::write(
        macro_file,
        format!("macro_rules! doc {{ {arms} }}"),
    )?)
}

/// The docstrings of classes, functions and methods by their name, which a method has behind its class and a dot.
fn docstrings(stub: &str) -> Vec<(String, String)> {
    let (mut class, mut name, mut found) = ("", String::new(), Vec::new());
    let mut lines = stub.lines();
    while let Some(line) = lines.next() {
        let word = |text: &'static str| {
            let rest = line.trim_start().strip_prefix(text)?;
            rest.split(['(', ':']).next()
        };
        if let Some(defined) = word("class ") {
            (class, name) = (defined, defined.to_owned());
        } else if let Some(defined) = word("def ") {
            let method = line.starts_with(' ');
            name = if method {
                format!("{class}.{defined}")
            } else {
                defined.to_owned()
            };
        } else if let Some(start) = line.trim_start().strip_prefix("\"\"\"") {
            let indent = line.len() - line.trim_start().len();
            let mut text = start.to_owned();
            while !text.ends_with("\"\"\"") {
                let Some(next) = lines.next() else { break };
                text.push('\n');
                text.push_str(next.get(indent..).unwrap_or_default());
            }
            if !name.is_empty() {
                found.push((
                    name.clone(),
                    text.trim_end_matches('"').trim_end().to_owned(),
                ));
            }
        }
    }
    found
}
