//! Replacing files.

use egp_wire::replace_file;

#[test]
fn what_another_container_writes_beside_the_same_file_stays() {
    let folder = std::env::temp_dir().join(format!("egp-beside-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let path = folder.join("library");
    let others = [0, 1, 2].map(|number| {
        let name = format!("library.{}.{number}.part", std::process::id());
        folder.join(name)
    });
    for other in &others {
        std::fs::write(other, "of another container").unwrap();
    }
    replace_file(&path, b"own").unwrap();
    assert_eq!(std::fs::read(&path).unwrap(), b"own");
    for other in &others {
        assert_eq!(std::fs::read(other).unwrap(), b"of another container");
    }
    assert_eq!(std::fs::read_dir(&folder).unwrap().count(), 4);
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn writers_of_one_file_do_not_remove_each_others_new_bytes() {
    let folder = std::env::temp_dir().join(format!("egp-writers-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let path = folder.join("library");
    std::thread::scope(|scope| {
        for writer in 0..4 {
            let path = &path;
            scope.spawn(move || {
                for round in 0..100 {
                    let replaced = replace_file(path, &[writer; 8]);
                    assert!(replaced.is_ok(), "{writer}, {round}: {replaced:?}");
                }
            });
        }
    });
    let bytes = std::fs::read(&path).unwrap();
    assert!((0..4).any(|writer| bytes == [writer; 8]), "{bytes:?}");
    assert_eq!(std::fs::read_dir(&folder).unwrap().count(), 1);
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn only_regular_files_are_replaced_and_links_stay() {
    use std::os::unix::fs::symlink;
    let folder = std::env::temp_dir().join(format!("egp-replaced-{}", std::process::id()));
    std::fs::create_dir_all(folder.join("inner")).unwrap();
    let path = |name: &str| folder.join(name);
    let made = std::process::Command::new("mkfifo")
        .arg(path("pipe"))
        .status();
    assert!(made.unwrap().success());
    symlink("pipe", path("to-pipe")).unwrap();
    symlink("circle", path("circle")).unwrap();
    for (name, reason) in [
        ("pipe", "got a folder, a pipe or a device"),
        ("to-pipe", "got a folder, a pipe or a device"),
        ("inner", "got a folder, a pipe or a device"),
        ("circle", "lead in a circle"),
    ] {
        let error = replace_file(&path(name), b"new").unwrap_err().to_string();
        assert!(error.contains(reason), "{name}: {error}");
    }
    std::fs::write(path("inner/target"), "old").unwrap();
    symlink("inner/target", path("first")).unwrap();
    symlink(path("first"), path("second")).unwrap();
    symlink("inner/later", path("dangling")).unwrap();
    for (link, target) in [("second", "inner/target"), ("dangling", "inner/later")] {
        replace_file(&path(link), b"new").unwrap();
        assert!(path(link).is_symlink(), "{link}");
        assert_eq!(std::fs::read(path(target)).unwrap(), b"new");
        assert!(!path(target).is_symlink(), "{target}");
    }
    assert!(path("first").is_symlink());
    std::fs::remove_dir_all(&folder).unwrap();
}
