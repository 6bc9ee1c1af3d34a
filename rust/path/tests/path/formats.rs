//! Track files: both formats, both heading conventions, and errors that name the line.

#![allow(clippy::unwrap_used)]

use std::f64::consts::{FRAC_PI_2, TAU};
use std::fmt::Write;

use egp_path::PathError;
use egp_path::formats::read_track;

/// Points `(x, y, yaw)` of a counter-clockwise circle of radius 20 m, with the first repeated.
fn circle() -> impl Iterator<Item = (f64, f64, f64)> {
    (0..=60).map(|i| TAU * f64::from(i % 60) / 60.0).map(|t| {
        let (sin, cos) = t.sin_cos();
        (20.0 * cos, 20.0 * sin, t + FRAC_PI_2)
    })
}

fn raceline(psi: fn(f64) -> f64) -> String {
    let mut text = String::from(
        "# made for a test\n#\n# s_m; x_m; y_m; psi_rad; kappa_radpm; vx_mps; ax_mps2\n",
    );
    for (i, (x, y, yaw)) in circle().enumerate() {
        let s = TAU * 20.0 * i as f64 / 60.0;
        writeln!(
            text,
            "{s:.7}; {x:.7}; {y:.7}; {:.7}; 0.05; 12.0; 0.0",
            psi(yaw)
        )
        .unwrap();
    }
    text
}

fn centre_line() -> String {
    let mut text = String::from("# x_m,y_m,w_tr_right_m,w_tr_left_m\n");
    for (x, y, _) in circle() {
        writeln!(text, "{x:.4}, {y:.4}, 2.0, 3.5").unwrap();
    }
    text
}

fn problem(text: &str) -> (usize, String) {
    match read_track(text, 1.0, true).unwrap_err() {
        PathError::Format { line, problem } => (line, problem),
        other => (0, other.to_string()),
    }
}

#[test]
fn racelines_are_read_with_either_heading() {
    for psi in [|yaw| yaw, |yaw| yaw - FRAC_PI_2, |yaw| yaw - TAU] {
        let path = read_track(&raceline(psi), 1.0, true).unwrap();
        assert!((path.length() - TAU * 20.0).abs() < 1e-3);
        assert!(path.closed() && !path.has_widths());
        assert!((path.sample(5.0).yaw - (5.0 / 20.0 + FRAC_PI_2)).abs() < 1e-4);
    }
}

#[test]
fn headings_of_neither_convention_are_errors() {
    for psi in [
        |yaw: f64| -yaw,
        |yaw| yaw + 1.0,
        |yaw: f64| yaw.to_degrees(),
        |_| 0.0,
    ] {
        let error = read_track(&raceline(psi), 1.0, true).unwrap_err();
        assert!(matches!(error, PathError::Heading { .. }), "{error}");
    }
}

#[test]
fn centre_lines_have_left_and_right_widths() {
    let path = read_track(&centre_line(), 1.0, true).unwrap();
    let at = path.sample(30.0);
    assert!((at.left - 3.5).abs() < 1e-9 && (at.right - 2.0).abs() < 1e-9);
    assert!((path.length() - TAU * 20.0).abs() < 1e-2);
    let path = read_track(&centre_line(), 10.0, true).unwrap();
    assert!((path.sample(30.0).left - 35.0).abs() < 1e-9);
    assert!((path.length() - TAU * 200.0).abs() < 1e-1);
    assert!(read_track(&centre_line(), 0.0, true).is_err());
}

#[test]
fn the_columns_of_a_centre_line_may_be_separated_by_semicolons() {
    let text = centre_line();
    let path = read_track(&text, 1.0, true).unwrap();
    for other in [
        text.replace(',', ";"),
        text.replacen("# ", "", 1).replace(',', ";"),
    ] {
        let read = read_track(&other, 1.0, true).unwrap();
        assert_eq!(read.sample(10.0), path.sample(10.0));
    }
}

#[test]
fn a_header_may_name_the_columns_in_any_order() {
    let (header, rows) = centre_line()
        .split_once('\n')
        .map(|(a, b)| (a.to_owned(), b.to_owned()))
        .unwrap();
    let swapped = "# x_m,y_m,w_tr_left_m,w_tr_right_m";
    let at = read_track(&format!("\u{feff}{swapped}\n{rows}"), 1.0, true)
        .unwrap()
        .sample(30.0);
    assert!((at.left - 2.0).abs() < 1e-9 && (at.right - 3.5).abs() < 1e-9);
    // Only the last comment with the name of a column is the header.
    let text = format!("{swapped}\n\n{header}\n{rows}");
    assert!((read_track(&text, 1.0, true).unwrap().sample(30.0).left - 3.5).abs() < 1e-9);
    assert!(read_track(&format!("# my track, made by hand\n{rows}"), 1.0, true).is_ok());
    let followed = format!("{swapped},\n# made by hand\n{rows}");
    assert!((read_track(&followed, 1.0, true).unwrap().sample(30.0).left - 2.0).abs() < 1e-9);
    let plain = format!(
        "# made by hand\n{}\n{rows}",
        swapped.trim_start_matches("# ")
    );
    assert!((read_track(&plain, 1.0, true).unwrap().sample(30.0).left - 2.0).abs() < 1e-9);
    for wrong in [
        "# x_m,y_m,left,right",
        "# x_m,y_m",
        "# x_m,x_m,w_tr_left_m,w_tr_right_m",
    ] {
        let (line, problem) = problem(&format!("#\n{wrong}\n{rows}"));
        assert_eq!(line, 2);
        assert!(
            problem.contains("w_tr_right_m, w_tr_left_m in any order, got x_m, "),
            "{problem}"
        );
    }
}

#[test]
fn errors_name_the_line() {
    let text = centre_line();
    assert_eq!(
        problem(&text.replacen("20.0000, 0.0000, 2.0, 3.5", "20.0000, 0.0000, 2.0", 1)),
        (
            2,
            "expected 4 columns x_m, y_m, w_tr_right_m, w_tr_left_m, got 3".into()
        )
    );
    assert_eq!(
        problem(&format!("{text}1.0,NaN,2.0,2.0\n")),
        (63, "expected a finite number for y_m, got \"NaN\"".into())
    );
    assert_eq!(
        problem("# empty\n\n"),
        (0, "expected at least 4 distinct points, got 0".into())
    );
    let half: String = text
        .lines()
        .take(30)
        .flat_map(|line| [line, "\n"])
        .collect();
    let (line, message) = problem(&half);
    assert!(
        line == 30 && message.contains("closed = false"),
        "{line}: {message}"
    );
    let mut lines: Vec<_> = text.lines().collect();
    lines.insert(8, lines[7]);
    assert!(problem(&lines.join("\n")).1.contains("are the same"));
    let shuffled = raceline(|yaw| yaw).replacen("2.0943951;", "0.0;", 1);
    assert_eq!(
        problem(&shuffled),
        (5, "s_m must increase, got 0 after 0".into())
    );
}
