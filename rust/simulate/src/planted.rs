//! Which oracle finds each planted fault, and with which seed.

use egp_wire::print_line;

use crate::config::Config;
use crate::mutant::Mutant;
use crate::oracle::Oracle;
use crate::scene::{Scene, SimulationError};
use crate::world::{repeat, simulate};

/// Seeds that are tried for each planted fault.
const TRIED: u64 = 200;
/// Columns of the terminal that the text of a planted fault takes.
const TEXT: usize = 60;
/// The same for the name of an oracle, which is followed by the seed.
const ORACLE: usize = 11;

/// Prints the table of all planted faults, as long as it is read; returns whether each was found.
pub(crate) fn print(scene: &Scene) -> Result<bool, SimulationError> {
    let head = rows("Planted fault", "oracle", "seed").join("\n");
    print_line(format_args!("{head}\n{}", "-".repeat(TEXT + ORACLE + 8)))?;
    let mut found = 0;
    for (tried, &mutant) in (1..).zip(Mutant::ALL) {
        let seed = first_seed(scene, mutant)?;
        found += usize::from(seed.is_some());
        let seed = seed.map_or("none".to_owned(), |seed| seed.to_string());
        let oracle = format!("{:?}", mutant.oracle());
        if !print_line(rows(mutant.text(), &oracle, &seed).join("\n"))? {
            return Ok(found == tried);
        }
    }
    let all = Mutant::ALL.len();
    print_line(format_args!(
        "\nThe seed is the first one that finds the fault; {TRIED} seeds are tried.\n\
         {found} of {all} planted faults were found by their oracle."
    ))?;
    Ok(found == all)
}

/// A row of the table, whose text may need several lines.
fn rows(text: &str, oracle: &str, seed: &str) -> Vec<String> {
    let mut lines = vec![String::new()];
    for word in text.split_whitespace() {
        let last = lines.len() - 1;
        let line = &mut lines[last];
        if line.is_empty() {
            word.clone_into(line);
        } else if line.len() + 1 + word.len() <= TEXT {
            line.push(' ');
            line.push_str(word);
        } else {
            lines.push(format!("  {word}"));
        }
    }
    lines[0] = format!("{:TEXT$}  {oracle:ORACLE$} {seed:>4}", lines[0]);
    lines
}

fn first_seed(scene: &Scene, mutant: Mutant) -> Result<Option<u64>, SimulationError> {
    for seed in 0..TRIED {
        let config = Config {
            mutant: Some(mutant),
            ..Config::new(seed)
        };
        let run = if mutant.oracle() == Oracle::Repeat {
            repeat(scene, &config)?
        } else {
            simulate(scene, &config)?
        };
        if run.violations.iter().any(|v| v.oracle == mutant.oracle()) {
            return Ok(Some(seed));
        }
    }
    Ok(None)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_fits_80_columns_and_keeps_every_word() {
        for mutant in Mutant::ALL {
            let lines = rows(mutant.text(), "Starvation", "none");
            assert!(lines.iter().all(|line| line.len() < 80), "{lines:?}");
            let words = lines.concat();
            for word in mutant.text().split_whitespace() {
                assert!(words.contains(word), "{word} of {lines:?}");
            }
        }
    }
}
