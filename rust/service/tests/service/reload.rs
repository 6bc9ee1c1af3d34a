//! A library is replaced while vehicles drive.
#![allow(clippy::unwrap_used, clippy::panic, missing_docs)]

use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use crate::loopback::{Client, Outcome, free_endpoint, request, step_key};
use egp_core::{Kernel, library};
use egp_driver::Carry;
use egp_service::{Handler as _, Libraries, ReloadError, Reloaded, ServiceConfig};
use egp_testing::libraries;
use egp_wire::{Code, LibraryId, Ready, Reply, Status, keys};

/// Replaces a library file as `egp train` does, and returns the hash of the new content.
fn replace(path: &Path, seed: u64) -> LibraryId {
    let spec = libraries::spec(Kernel::Rbf, &[0.5, 1.1], 80, seed);
    let bytes = library::encode(&spec).unwrap();
    let whole = path.with_extension("new");
    std::fs::write(&whole, &bytes).unwrap();
    std::fs::rename(&whole, path).unwrap();
    egp_core::Library::from_bytes(&bytes).unwrap().id()
}

fn config(name: &str, seed: u64) -> (ServiceConfig, LibraryId) {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    let id = replace(&path, seed);
    let mut config = ServiceConfig::new(path);
    config.workers = Some(1);
    config.settings.horizon = Some(20);
    (config, id)
}

#[test]
fn a_request_is_answered_by_the_library_that_it_states() {
    let (mut config, first) = config("stated.safetensors", 10);
    let (further, other) = self::config("further.safetensors", 11);
    config.libraries = vec![further.library];
    config.max_libraries = 3;
    let served = Libraries::load(&config).unwrap();
    let mut memory = served.workspace().unwrap();
    let mut step = |id: LibraryId| {
        let mut reply = Vec::new();
        let request = request(&mut Carry::new(id, 10)).encode();
        let ended = served.step(&mut memory, &request, &mut reply);
        let reply = ended.map(|_| Reply::decode(&reply).unwrap());
        reply.map(|reply| reply.library)
    };
    assert_eq!((step(first), step(other)), (Ok(first), Ok(other)));
    let third = replace(&config.library, 12);
    assert_eq!(step(third).unwrap_err().code, Code::UnknownLibrary);
    assert_eq!(served.reload().unwrap(), Reloaded::Changed(third));
    assert_eq!(served.ids(), [third, first, other]);
    assert_eq!((step(first), step(other)), (Ok(first), Ok(other)));
    assert_eq!(served.reload().unwrap(), Reloaded::Same(third));
    assert_eq!(step(third), Ok(third));
    // What the fourth would replace is in use.
    replace(&config.library, 13);
    assert!(matches!(
        served.reload(),
        Err(ReloadError::Full { limit: 3 })
    ));
    std::fs::write(&config.library, b"no library").unwrap();
    assert!(matches!(served.reload(), Err(ReloadError::Engine(_))));
    // A library from before needs no place.
    replace(&config.library, 10);
    assert_eq!(served.reload().unwrap(), Reloaded::Changed(first));
    let ready = served.describe();
    assert_eq!((ready.library, ready.others), (first, vec![third, other]));
    assert_eq!(step(third), Ok(third));
}

/// A service in a process of its own, which is killed at the end.
struct Service(Child);

impl Drop for Service {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Asks every 20 ms until `stop`, always for the same library; the number of answered requests.
fn drive(client: Client, id: LibraryId, vehicle: &str, stop: Arc<AtomicBool>) -> JoinHandle<u32> {
    let key = step_key(vehicle);
    thread::spawn(move || {
        let (mut carry, mut answered, mut due) = (Carry::new(id, 10), 0, Instant::now());
        while !stop.load(Ordering::Acquire) {
            let bytes = request(&mut carry).encode();
            let Outcome::Answer { payload, .. } = client.ask(&key, &bytes) else {
                panic!("no answer after {answered}");
            };
            let reply = Reply::decode(&payload).unwrap();
            assert_eq!((reply.status, reply.library), (Status::Solved, id));
            carry.accept(&reply);
            answered += 1;
            due += Duration::from_millis(20);
            thread::sleep(due.saturating_duration_since(Instant::now()));
        }
        answered
    })
}

#[test]
fn ten_reloads_under_load_miss_no_step() {
    let endpoint = free_endpoint();
    let (config, first) = config("reloaded.safetensors", 20);
    let file = config.library.with_extension("toml");
    let text = "max_libraries = 5\nwatch_ms = 20\n[settings]\nhorizon = 20\n";
    std::fs::write(&file, format!("library = {:?}\n{text}", config.library)).unwrap();
    let process = Command::new(env!("CARGO_BIN_EXE_egp-server"))
        .args(["--workers", "2", "--listen", &endpoint, "--config"])
        .arg(&file)
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let service = Service(process);
    let client = Client::connect(&endpoint);
    let key = keys::ready(&"main".parse().unwrap());
    let ready = || match client.ask(&key, &[]) {
        Outcome::Answer { payload, .. } => Ready::decode(&payload).unwrap(),
        other => panic!("{other:?}"),
    };
    let stop = Arc::new(AtomicBool::new(false));
    let vehicle = |name, id| drive(Client::connect(&endpoint), id, name, stop.clone());
    let mut vehicles = vec![vehicle("car-0", first), vehicle("car-1", first)];
    for reload in 0..10 {
        let library = replace(&config.library, 21 + reload);
        if reload % 2 == 1 {
            let (pid, kill) = (service.0.id().to_string(), Command::new("kill"));
            assert!({ kill }.args(["-HUP", &pid]).status().unwrap().success());
        }
        let late = Instant::now() + Duration::from_secs(20);
        while ready().library != library {
            assert!(Instant::now() < late, "reload {reload} had no effect");
            thread::sleep(Duration::from_millis(5));
        }
        if reload == 2 {
            vehicles.push(vehicle("car-2", library));
        }
        thread::sleep(Duration::from_millis(100));
    }
    // Those in use are kept, whatever their age; of the others, the newest.
    assert!(ready().serves(&first));
    assert_eq!(ready().libraries().len(), 5);
    stop.store(true, Ordering::Release);
    for vehicle in vehicles {
        let answered = vehicle.join().unwrap();
        assert!(answered > 20, "only {answered} answers");
    }
}

/// Signs a library as `egp sign` does, and returns the public key as a line of text.
fn sign(path: &Path, seed: u8) -> String {
    use ring::signature::{Ed25519KeyPair, KeyPair as _};
    let key = Ed25519KeyPair::from_seed_unchecked(&[seed; 32]).unwrap();
    let id = egp_core::Library::from_bytes(&std::fs::read(path).unwrap())
        .unwrap()
        .id();
    let signature = key.sign(&[b"egp.v1 library\0".as_slice(), &id].concat());
    let beside = path.with_extension("safetensors.sig");
    std::fs::write(beside, library::hex(signature.as_ref()) + "\n").unwrap();
    library::hex(key.public_key().as_ref())
}

#[test]
fn a_signature_is_offered_as_the_last_reload_found_it() {
    let (config, first) = config("resigned.safetensors", 40);
    let beside = config.library.with_extension("safetensors.sig");
    let _ = std::fs::remove_file(&beside);
    let served = Libraries::load(&config).unwrap();
    let offered = |id: &LibraryId| served.content(id).unwrap().signature;
    let on_disk = || {
        let text = std::fs::read_to_string(&beside).unwrap();
        egp_wire::from_hex::<64>(text.trim())
    };
    assert_eq!(offered(&first), None);
    sign(&config.library, 1);
    assert_eq!(served.reload().unwrap(), Reloaded::Same(first));
    assert!(on_disk().is_some());
    assert_eq!(offered(&first), on_disk());
    // Another library, and the first one again with another signature.
    std::fs::remove_file(&beside).unwrap();
    let second = replace(&config.library, 41);
    assert_eq!(served.reload().unwrap(), Reloaded::Changed(second));
    assert!(offered(&first).is_some() && offered(&second).is_none());
    replace(&config.library, 40);
    sign(&config.library, 2);
    assert_eq!(served.reload().unwrap(), Reloaded::Changed(first));
    assert_eq!(offered(&first), on_disk());
    assert_eq!(offered(&second), None);
}

#[test]
fn with_keys_only_signed_libraries_are_served() {
    let (mut config, first) = config("signed.safetensors", 30);
    let keys = config.library.with_extension("pub");
    let beside = config.library.with_extension("safetensors.sig");
    let _ = std::fs::remove_file(&beside);
    let own = sign(&config.library, 1);
    std::fs::write(
        &keys,
        format!(
            "# the old key, and the new one\n{}\n\n{own}\n",
            "11".repeat(32)
        ),
    )
    .unwrap();
    config.library_keys = Some(keys.clone());
    let served = Libraries::load(&config).unwrap();
    assert_eq!(served.ids(), [first]);
    // Another library beside the signature of the first, and one with the signature of a stranger.
    let second = replace(&config.library, 31);
    let failure = |served: &Libraries| served.reload().unwrap_err().to_string();
    assert!(failure(&served).contains("is not signed by any of the 2 configured keys"));
    sign(&config.library, 2);
    assert!(failure(&served).contains("is not signed by any of the 2 configured keys"));
    for (text, words) in [
        ("12", "expected 64 bytes"),
        ("+1+1", "expected 64 bytes"),
        ("ä", "expected 64 bytes"),
    ] {
        std::fs::write(&beside, text).unwrap();
        assert!(failure(&served).contains(words));
    }
    std::fs::remove_file(&beside).unwrap();
    assert!(failure(&served).contains("`egp sign` writes the signature"));
    assert_eq!(served.ids(), [first]);
    assert_eq!(sign(&config.library, 1), own);
    assert_eq!(served.reload().unwrap(), Reloaded::Changed(second));
    // Each reload reads the keys again: one that was added counts, and one that was removed does not.
    let added = sign(&config.library, 2);
    std::fs::write(&keys, &added).unwrap();
    assert_eq!(served.reload().unwrap(), Reloaded::Same(second));
    sign(&config.library, 1);
    assert!(failure(&served).contains("is not signed by any of the 1 configured keys"));
    std::fs::write(&keys, "# none\n").unwrap();
    assert!(failure(&served).contains("there is no public key in it"));
    let error = Libraries::load(&config).err().unwrap().to_string();
    assert!(error.contains("there is no public key in it"), "{error}");
    // A file of the vehicles' secret keys in place of that of the signers is not shown.
    std::fs::write(&keys, "# secret\ndefault/car-1 5ec2e7\n").unwrap();
    let error = Libraries::load(&config).err().unwrap().to_string();
    assert!(error.contains("line 2: expected 32 bytes"), "{error}");
    assert!(!error.contains("5ec2e7"), "{error}");
}
