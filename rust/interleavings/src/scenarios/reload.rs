//! Libraries that are replaced while steps are computed.

use std::fs;
use std::path::Path;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};

use egp_core::{Kernel, Library, library};
use egp_testing::{libraries, messages};
use egp_wire::{Code, LibraryId, Reply};

use crate::config::ServiceConfig;
use crate::handler::Handler as _;
use crate::libraries::Libraries;
use crate::library_table::Reloaded;
use crate::reloader::Reloader;
use crate::sync::{Arc, mpsc, thread};

/// A library of one small member.
struct Made {
    bytes: Vec<u8>,
    id: LibraryId,
    request: Vec<u8>,
}

/// Two libraries of the same vehicle.
fn made() -> &'static [Made; 2] {
    static MADE: OnceLock<[Made; 2]> = OnceLock::new();
    MADE.get_or_init(|| {
        [10, 11].map(|seed| {
            let bytes = library::encode(&libraries::spec(Kernel::Rbf, &[0.5], 8, seed)).unwrap();
            let id = Library::from_bytes(&bytes).unwrap().id();
            let mut request = messages::cold_request();
            request.library = id;
            Made {
                request: request.encode(),
                bytes,
                id,
            }
        })
    })
}

/// The libraries of a service whose file is replaced by the second library after the start.
fn replaced(file: &Path) -> Arc<Libraries> {
    let [old, new] = made();
    fs::write(file, &old.bytes).unwrap();
    let mut config = ServiceConfig::new(file);
    config.workers = Some(1);
    config.settings.horizon = Some(4);
    let libraries = Libraries::load(&config).unwrap();
    fs::write(file, &new.bytes).unwrap();
    Arc::new(libraries)
}

/// Vehicles ask for the old library and for the new one while the file is loaded again on command. The old library is
/// served throughout, the new one from the end of its loading at the latest, each reply comes from the library that the
/// request states, and the command is obeyed although the reloader is stopped right after it.
pub fn libraries_change_between_steps(file: &Path) {
    let libraries = replaced(file);
    let loaded = Arc::new(AtomicBool::new(false));
    let vehicles: Vec<_> = made()
        .iter()
        .enumerate()
        .map(|(index, made)| {
            let (libraries, loaded) = (libraries.clone(), loaded.clone());
            thread::spawn(move || {
                let mut memory = libraries.workspace().unwrap();
                let mut served = index == 0;
                for _ in 0..3 {
                    served |= loaded.load(Ordering::Relaxed);
                    let mut reply = Vec::new();
                    match libraries.step(&mut memory, &made.request, &mut reply) {
                        Ok(_) => {
                            served = true;
                            let reply = Reply::decode(&reply).unwrap();
                            assert_eq!(reply.library, made.id);
                        }
                        Err(error) => {
                            assert!(!served && error.code == Code::UnknownLibrary, "{error}");
                        }
                    }
                }
            })
        })
        .collect();
    let (outcomes, noted) = mpsc::channel();
    let note = loaded.clone();
    let reloader = Reloader::new(libraries.clone(), None, None);
    let running = reloader.start(move |outcome| {
        note.store(true, Ordering::Relaxed);
        let _ = outcomes.send(outcome.map_err(|error| error.to_string()));
    });
    let running = running.unwrap();
    running.reload().unwrap();
    drop(running);
    let [old, new] = made();
    let both = vec![new.id, old.id];
    assert_eq!(
        noted.recv(),
        Ok(Ok((Reloaded::Changed(new.id), both.clone())))
    );
    for vehicle in vehicles {
        vehicle.join().unwrap();
    }
    assert_eq!(libraries.ids(), both);
}

/// Two threads load the file again at the same time: one finds a new library, the other that it is served already.
pub fn one_reload_at_a_time(file: &Path) {
    let libraries = replaced(file);
    let [old, new] = made();
    let reloads: Vec<_> = (0..2)
        .map(|_| {
            let libraries = libraries.clone();
            thread::spawn(move || libraries.reload().unwrap())
        })
        .collect();
    let outcomes: Vec<_> = reloads
        .into_iter()
        .map(|thread| thread.join().unwrap())
        .collect();
    assert!(outcomes.contains(&Reloaded::Changed(new.id)));
    assert!(outcomes.contains(&Reloaded::Same(new.id)));
    assert_eq!(libraries.ids(), [new.id, old.id]);
}
