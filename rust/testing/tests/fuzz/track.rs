//! Track files: centre lines and racelines.

use std::f64::consts::{PI, TAU};
use std::fmt::Write as _;

use egp_path::formats::read_track;

use crate::edits::Words;
use crate::{TIME, fuzz};

const WORDS: Words = Words::Texts(&[
    "0", "-0.0", "-1", "1e-9", "1e-320", "1e9", "1e308", "1e400", "nan", "inf", "#", ",", ";",
    "\n", "",
]);

/// A circle of radius 5 m in `rows` rows, each written by `row` from its angle.
fn circle(rows: u32, row: impl Fn(&mut String, f64)) -> Vec<u8> {
    let mut text = "# a circle\n".to_owned();
    for i in 0..rows {
        row(&mut text, TAU * f64::from(i) / f64::from(rows));
    }
    text.into_bytes()
}

#[test]
fn an_accepted_track_is_a_lap_with_edges() {
    let centre_line = circle(12, |text, angle| {
        let (sin, cos) = angle.sin_cos();
        writeln!(text, "{:.4},{:.4},2.0,3.5", 5.0 * cos, 5.0 * sin).unwrap();
    });
    let raceline = circle(12, |text, angle| {
        let (sin, cos) = angle.sin_cos();
        let (s, psi) = (5.0 * angle, angle + 0.5 * PI);
        writeln!(
            text,
            "{s:.4};{:.4};{:.4};{psi:.4};0.2;12;0",
            5.0 * cos,
            5.0 * sin
        )
        .unwrap();
    });
    // Most edits of a position make a kink, which takes tens of milliseconds to detect.
    fuzz!(5 * TIME, [centre_line, raceline], WORDS, |bytes: Vec<
        u8,
    >| {
        let closed = bytes.len().is_multiple_of(2);
        let Ok(path) = read_track(&String::from_utf8_lossy(&bytes), 1.0, closed) else {
            return;
        };
        let length = path.length();
        assert!(length > 0.0 && length.is_finite() && path.closed() == closed);
        for lap in [-1.5, 0.0, 0.3, 1.0, 2.7] {
            let (s, at) = (path.wrap(lap * length), path.sample(lap * length));
            assert!(!closed || (0.0..=length).contains(&s));
            assert!(
                [at.x, at.y, at.yaw, at.curvature]
                    .iter()
                    .all(|value| value.is_finite())
            );
            assert!(at.left >= 0.0 && at.right >= 0.0);
            assert_eq!(at.left.is_finite(), path.has_widths());
        }
    });
}
