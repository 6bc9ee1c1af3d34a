//! A service as its operator sees it: pages over HTTP, and the log.
#![allow(clippy::unwrap_used, missing_docs)]

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use crate::loopback::{
    Client, Outcome, config, engine, first_request, free_endpoint, library_file, step_key,
};
use egp_service::map::{MapConfig, MapServer, check_map};
use egp_service::{Server, ServiceConfig, check};
use egp_testing::outputs::without_output;
use egp_testing::ports::free_port;
use serde_json::Value;
use zenoh::Wait as _;

pub fn free_address() -> SocketAddr {
    ([127, 0, 0, 1], free_port()).into()
}

/// Status and body of the answer to one request over HTTP; an error if nobody listens.
pub fn ask(address: SocketAddr, method: &str, path: &str) -> std::io::Result<(u16, String)> {
    let mut stream = TcpStream::connect(address)?;
    stream.set_read_timeout(Some(Duration::from_secs(10)))?;
    write!(
        stream,
        "{method} {path} HTTP/1.1\r\nHost: test\r\nConnection: close\r\n\r\n"
    )?;
    let mut answer = String::new();
    stream.read_to_string(&mut answer)?;
    let (head, body) = answer.split_once("\r\n\r\n").unwrap_or((&answer, ""));
    let status = head.split(' ').nth(1).and_then(|text| text.parse().ok());
    Ok((status.unwrap_or(0), body.to_owned()))
}

/// A service process with HTTP, and a drain of a second.
fn start(name: &str, endpoint: &str, http: SocketAddr) -> Child {
    let library = library_file(name);
    let config = library.with_extension("toml");
    let text = format!(
        "library = \"{}\"\nhttp = \"{http}\"\ndrain_ms = 1000\nlog_json = true\n\
         log = \"info,zenoh=warn,egp_service::request=debug\"\n[settings]\nhorizon = 20\n",
        library.display()
    );
    std::fs::write(&config, text).unwrap();
    Command::new(env!("CARGO_BIN_EXE_egp-server"))
        .args(["--workers", "1", "--listen", endpoint, "--config"])
        .arg(&config)
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

/// A service process with HTTP that is a client of a router.
fn start_client(name: &str, router: &str, http: SocketAddr) -> Child {
    client(name, router, http, "off").spawn().unwrap()
}

/// The command of [`start_client`], with this filter of the log.
pub fn client(name: &str, router: &str, http: SocketAddr, log: &str) -> Command {
    let library = library_file(name);
    let config = library.with_extension("toml");
    let text = format!(
        "library = \"{}\"\nhttp = \"{http}\"\nlog = \"{log}\"\n[zenoh]\nmode = '\"client\"'\n\
         \"listen/endpoints\" = '[]'\n\"connect/endpoints\" = '[\"{router}\"]'\n",
        library.display()
    );
    std::fs::write(&config, text).unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_egp-server"));
    command.arg("--config").arg(&config);
    command
}

/// A router of zenoh in this process.
fn router(endpoint: &str) -> zenoh::Session {
    let mut settings = zenoh::Config::default();
    for (key, value) in [
        ("mode", "\"router\"".to_owned()),
        ("listen/endpoints", format!("[\"{endpoint}\"]")),
        ("scouting/multicast/enabled", "false".to_owned()),
    ] {
        settings.insert_json5(key, &value).unwrap();
    }
    zenoh::open(settings).wait().unwrap()
}

/// Waits until a page has these words.
pub fn wait_for(http: SocketAddr, page: &str, words: &str) {
    let late = Instant::now() + Duration::from_secs(60);
    while !ask(http, "GET", page).is_ok_and(|(_, text)| text.contains(words)) {
        assert!(Instant::now() < late, "{words} on {page}");
        std::thread::sleep(Duration::from_millis(20));
    }
}

pub fn signal(process: &Child, name: &str) {
    let kill = Command::new("kill")
        .args([name, &process.id().to_string()])
        .status();
    assert!(kill.unwrap().success());
}

#[test]
fn pages_and_log_follow_a_process_from_start_to_drain() {
    let (endpoint, http) = (free_endpoint(), free_address());
    let mut process = start("operating.safetensors", &endpoint, http);
    let client = Client::connect(&endpoint);
    let mut request = first_request();
    request.sequence = 41;
    let outcome = client.ask(&step_key("car"), &request.encode());
    assert!(matches!(outcome, Outcome::Answer { .. }), "{outcome:?}");
    let outcome = client.ask(&step_key("stranger"), b"no request");
    assert!(matches!(outcome, Outcome::Error(_)), "{outcome:?}");

    let page = |path| ask(http, "GET", path).unwrap();
    assert_eq!(page("/health"), (200, "ok\n".to_owned()));
    assert_eq!(page("/ready?verbose"), (200, "ready\n".to_owned()));
    assert_eq!(ask(http, "HEAD", "/ready").unwrap(), (200, String::new()));
    assert_eq!(ask(http, "POST", "/ready").unwrap().0, 405);
    assert_eq!(page("/nonsense").0, 404);
    let (status, metrics) = page("/metrics");
    assert_eq!(status, 200);
    for line in [
        "egp_requests_total{outcome=\"solved\"} 1",
        "egp_requests_total{outcome=\"malformed\"} 1",
        "egp_step_seconds_count 1",
        "egp_workers 1",
        "# EOF",
    ] {
        assert!(metrics.lines().any(|l| l == line), "{line}:\n{metrics}");
    }

    let pid = process.id().to_string();
    let kill = Command::new("kill").args(["-TERM", &pid]).status();
    assert!(kill.unwrap().success());
    // The process is alive and not ready for a second, and then nobody listens.
    let mut seen = Vec::new();
    while let Ok((status, body)) = ask(http, "GET", "/ready") {
        if seen.last() != Some(&(status, body.clone())) {
            seen.push((status, body));
        }
        if status == 503 && seen.len() < 3 {
            assert_eq!(page("/health").0, 200);
            break;
        }
    }
    let draining = (503, "draining\n".to_owned());
    assert_eq!(seen.last(), Some(&draining), "{seen:?}");
    assert!(process.wait().unwrap().success());
    assert!(ask(http, "GET", "/health").is_err());

    let log = BufReader::new(process.stderr.take().unwrap());
    let events: Vec<Value> = log
        .lines()
        .map(|line| serde_json::from_str(&line.unwrap()).unwrap())
        .collect();
    let event = |message: &str| {
        let mut found = events.iter().filter(|event| event["message"] == message);
        found.next().unwrap_or(&Value::Null)
    };
    let answered = event("answered");
    assert_eq!(answered["target"], "egp_service::request");
    assert_eq!(
        (&answered["fleet"], &answered["vehicle"]),
        (&"fleet".into(), &"car".into())
    );
    assert_eq!(answered["sequence"], 41);
    assert_eq!(answered["status"], "solved");
    assert!(answered["step_us"].as_u64().unwrap() > 0, "{answered}");
    let refused = event("refused");
    assert_eq!(refused["vehicle"], "stranger");
    assert_eq!(refused["code"], "malformed");
    assert_eq!(event("drained")["level"], "INFO");
}

#[test]
fn a_service_that_waits_for_its_router_is_alive_and_not_ready() {
    let (router, http) = (free_endpoint(), free_address());
    let mut process = start_client("waiting.safetensors", &router, http);
    let late = Instant::now() + Duration::from_secs(20);
    while ask(http, "GET", "/health").is_err() && Instant::now() < late {
        std::thread::sleep(Duration::from_millis(20));
    }
    let page = |path: &str| ask(http, "GET", path).unwrap();
    let (health, ready) = (page("/health"), page("/ready"));
    process.kill().unwrap();
    process.wait().unwrap();
    assert_eq!(health, (200, "ok\n".to_owned()));
    assert_eq!(ready, (503, "starting\n".to_owned()));
}

#[test]
fn a_sighup_that_comes_while_the_service_waits_for_its_router_reloads_after_the_start() {
    let (router, http) = (free_endpoint(), free_address());
    let mut process = start_client("early.safetensors", &router, http);
    wait_for(http, "/ready", "starting");
    signal(&process, "-HUP");
    // The service looks for signals between its attempts, half a second apart; a later signal has its effect in any case.
    std::thread::sleep(Duration::from_millis(1500));
    let session = self::router(&router);
    wait_for(http, "/ready", "ready\n");
    wait_for(http, "/metrics", "egp_reloads_total{outcome=\"same\"} 1");
    process.kill().unwrap();
    process.wait().unwrap();
    drop(session);
}

#[test]
fn a_replica_that_is_cut_off_from_its_router_is_not_ready_until_it_has_a_link_again() {
    let (endpoint, http) = (free_endpoint(), free_address());
    let first = router(&endpoint);
    let mut command = client("cut-off.safetensors", &endpoint, http, "info");
    let mut process = command.stderr(Stdio::piped()).spawn().unwrap();
    wait_for(http, "/ready", "ready\n");
    wait_for(http, "/metrics", "egp_links 1\n");
    first.close().wait().unwrap();
    wait_for(http, "/ready", "disconnected\n");
    assert_eq!(ask(http, "GET", "/ready").unwrap().0, 503);
    assert_eq!(ask(http, "GET", "/health").unwrap().0, 200);
    wait_for(http, "/metrics", "egp_links 0\n");
    let second = router(&endpoint);
    wait_for(http, "/ready", "ready\n");
    process.kill().unwrap();
    let log = String::from_utf8(process.wait_with_output().unwrap().stderr).unwrap();
    let (lost, again) = (
        log.find("link to the router is lost"),
        log.find("connected links=1"),
    );
    assert!(lost.is_some() && lost < again, "{log}");
    drop(second);
}

#[test]
fn a_program_that_stops_reading_the_log_stops_no_service() {
    let (endpoint, http) = (free_endpoint(), free_address());
    let library = library_file("unread-log.safetensors");
    let (reader, mut unread) = std::io::pipe().unwrap();
    let mut process = Command::new(env!("CARGO_BIN_EXE_egp-server"))
        .args([
            "--workers",
            "1",
            "--listen",
            &endpoint,
            "--http",
            &http.to_string(),
            "--library",
        ])
        .arg(&library)
        .stderr(unread.try_clone().unwrap())
        .spawn()
        .unwrap();
    // Whatever room the pipe has is filled, and the thread ends when the reader does.
    let filler = std::thread::spawn(move || unread.write_all("\n".repeat(1 << 21).as_bytes()));
    Client::connect(&endpoint);
    assert_eq!(
        ask(http, "GET", "/ready").unwrap(),
        (200, "ready\n".to_owned())
    );
    let (_, metrics) = ask(http, "GET", "/metrics").unwrap();
    assert!(metrics.contains("egp_log_lines_lost_total "), "{metrics}");
    signal(&process, "-TERM");
    let late = Instant::now() + Duration::from_secs(20);
    while process.try_wait().unwrap().is_none() && Instant::now() < late {
        std::thread::sleep(Duration::from_millis(20));
    }
    let ended = process.try_wait().unwrap();
    process.kill().unwrap();
    process.wait().unwrap();
    drop(reader);
    assert!(filler.join().unwrap().is_err(), "the pipe took everything");
    assert!(ended.is_some_and(|status| status.success()), "{ended:?}");
}

#[test]
fn services_with_one_name_are_counted_after_the_start_too() {
    let (endpoint, http) = (free_endpoint(), free_address());
    let first = Server::start_with(&config(&endpoint), engine()).unwrap();
    let mut other = config(&free_endpoint());
    other.http = Some(http);
    (other.zenoh).insert("connect/endpoints".to_owned(), format!("[\"{endpoint}\"]"));
    let second = Server::start_with(&other, engine()).unwrap();
    wait_for(http, "/metrics", "egp_name_twice_total 1\n");
    drop((first, second));
}

#[test]
fn requests_that_announce_a_body_or_never_end_harm_nobody() {
    let (endpoint, http) = (free_endpoint(), free_address());
    let mut process = start("bodies.safetensors", &endpoint, http);
    Client::connect(&endpoint);
    let open = |text: &str| {
        let mut stream = TcpStream::connect(http).unwrap();
        stream.write_all(text.as_bytes()).unwrap();
        stream
    };
    let announced = ["2000", "1000000000000000", "9223372036854775808"].map(|length| {
        open(&format!(
            "GET /health HTTP/1.1\r\nHost: egp\r\nContent-Length: {length}\r\n\r\n"
        ))
    });
    let endless = open("GET /health HTTP/1.1\r\nX: ");
    let silent: Vec<_> = (0..300).map(|_| open("")).collect();
    for _ in 0..3 {
        assert_eq!(ask(http, "GET", "/health").unwrap().0, 200);
    }
    for mut stream in announced {
        let mut answer = String::new();
        // The connection may be reset behind the answer, because the body is not read.
        let _ = stream.read_to_string(&mut answer);
        assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");
    }
    let pid = process.id().to_string();
    let asked = Instant::now();
    let kill = Command::new("kill").args(["-TERM", &pid]).status();
    assert!(kill.unwrap().success());
    assert!(process.wait().unwrap().success());
    assert!(asked.elapsed() < Duration::from_secs(4));
    drop((endless, silent));
}

#[test]
fn an_address_in_use_is_an_error_in_words() {
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap();
    let process = start("taken.safetensors", &free_endpoint(), address);
    let output = process.wait_with_output().unwrap();
    let message = String::from_utf8(output.stderr).unwrap();
    let words = format!("cannot listen for HTTP on {address}");
    assert!(
        !output.status.success() && message.contains(&words),
        "{message}"
    );
}

#[test]
fn a_check_looks_at_the_host_for_http_and_not_at_its_port() {
    let mut config = ServiceConfig::new(library_file("checked.safetensors"));
    config.settings.horizon = Some(20);
    config.http = Some("192.0.2.1:9464".parse().unwrap());
    let message = check(&config).unwrap_err().to_string();
    let words = "cannot listen for HTTP on 192.0.2.1:9464";
    assert!(message.contains(words), "{message}");
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    config.http = Some(taken.local_addr().unwrap());
    assert!(check(&config).is_ok());
}

#[test]
fn a_check_ends_without_an_error_if_nobody_reads_what_it_prints() {
    let library = library_file("unread.safetensors");
    let [unread, _] = without_output("egp-server", 1, || {
        let mut command = Command::new(env!("CARGO_BIN_EXE_egp-server"));
        command.args(["--check", "--library"]).arg(&library);
        command
    });
    assert!(unread.stderr.is_empty(), "{unread:?}");
}

#[test]
fn a_map_shows_its_state_over_http_too() {
    let http = free_address();
    let mut config = MapConfig {
        http: Some(http),
        ..MapConfig::default()
    };
    let listen = format!("[\"{}\"]", free_endpoint());
    config.zenoh.insert("listen/endpoints".to_owned(), listen);
    let server = MapServer::start(&config).unwrap();
    let page = |path| ask(http, "GET", path).unwrap();
    assert_eq!(page("/health"), (200, "ok\n".to_owned()));
    assert_eq!(page("/ready"), (200, "ready\n".to_owned()));
    let (_, metrics) = page("/metrics");
    for line in ["egp_map_unsaved_roads 0", "egp_map_links 0", "# EOF"] {
        assert!(metrics.lines().any(|l| l == line), "{line}:\n{metrics}");
    }
    assert!(MapServer::start(&config).is_err(), "the address is in use");
    // A check looks at the host and not at the port.
    assert_eq!(check_map(&config).unwrap(), None);
    config.http = Some("192.0.2.1:9464".parse().unwrap());
    let message = check_map(&config).unwrap_err().to_string();
    assert!(
        message.contains("cannot listen for HTTP on 192.0.2.1:9464"),
        "{message}"
    );
    server.stop().unwrap();
    assert!(ask(http, "GET", "/health").is_err());
}
