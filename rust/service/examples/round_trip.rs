//! Both ends of a query, for `tests/bench/round_trip.py`: `answer ENDPOINT KEY BYTES` answers each query at once, without
//! anything of the service, and `ask ENDPOINT KEY FILE COUNT` sends the bytes of a file again and again, one query after
//! the other, and prints a line `round trip, in the queue, in the step` in µs for each.
#![allow(clippy::print_stdout)]

use std::time::{Duration, Instant};

use egp_wire::Timing;
use prost::Message as _;
use zenoh::{Config, Wait};

type Failure = Box<dyn std::error::Error + Send + Sync>;

/// Queries that are not counted, because connections and memory are made in them.
const WARM_UP: usize = 200;
const USAGE: &str =
    "usage: round_trip answer ENDPOINT KEY BYTES, or round_trip ask ENDPOINT KEY FILE COUNT";

fn main() -> Result<(), Failure> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    match words[..] {
        ["answer", endpoint, key, bytes] => answer(endpoint, key, bytes.parse()?),
        ["ask", endpoint, key, file, count] => {
            ask(endpoint, key, &std::fs::read(file)?, count.parse()?)
        }
        _ => Err(USAGE.into()),
    }
}

/// The service's settings of zenoh, at one endpoint.
fn configuration(end: &str, endpoint: &str) -> Result<Config, Failure> {
    let mut config = Config::default();
    for (key, value) in [
        ("listen/endpoints", "[]"),
        (end, &format!("[\"{endpoint}\"]")),
        ("scouting/multicast/enabled", "false"),
        ("transport/shared_memory/enabled", "false"),
    ] {
        config.insert_json5(key, value)?;
    }
    Ok(config)
}

fn answer(endpoint: &str, key: &str, bytes: usize) -> Result<(), Failure> {
    let session = zenoh::open(configuration("listen/endpoints", endpoint)?).wait()?;
    let (reply, own) = (vec![0_u8; bytes], key.to_owned());
    let _queryable = session
        .declare_queryable(key)
        .callback(move |query| {
            // Who asked and is gone already needs no answer.
            let _ = query.reply(&own, reply.clone()).wait();
        })
        .wait()?;
    loop {
        std::thread::park();
    }
}

fn ask(endpoint: &str, key: &str, request: &[u8], count: usize) -> Result<(), Failure> {
    let session = zenoh::open(configuration("connect/endpoints", endpoint)?).wait()?;
    std::thread::sleep(Duration::from_millis(500)); // for the declaration of the key
    for query in 0..WARM_UP + count {
        let begun = Instant::now();
        let replies = session.get(key).payload(request).wait()?;
        let reply = replies.recv()?;
        let took = begun.elapsed();
        let sample = reply.result().map_err(|error| {
            let text = String::from_utf8_lossy(&error.payload().to_bytes()).into_owned();
            format!("query {query} was answered with an error: {text}")
        })?;
        let attachment = sample.attachment().map(|bytes| bytes.to_bytes());
        let timing = match &attachment {
            Some(bytes) => Timing::decode(&bytes[..])?,
            None => Timing::default(),
        };
        if query >= WARM_UP {
            let (queue, step) = (timing.queue_us, timing.step_us);
            println!("{:.1} {queue} {step}", 1e6 * took.as_secs_f64());
        }
    }
    Ok(())
}
