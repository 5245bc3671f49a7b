//! Writes settings to a configuration file. Its comments, its order and everything else in it stay.

use std::fs;
use std::io::Write;
use std::os::unix::fs::{MetadataExt, PermissionsExt, chown};
use std::path::{Path, PathBuf};

use toml_edit::{DocumentMut, Item, Table, Value};

use crate::config::{Key, Settings};

/// Most bytes of a configuration file that are read.
const LARGEST: u64 = 1 << 20;

/// The text of a configuration file in which `keys` have the values of `wanted`. `name` is for messages.
///
/// # Errors
/// Where the text is no configuration, before or after.
pub(super) fn edited(name: &str, text: &str, keys: &[&Key], wanted: &Settings) -> Result<String, String> {
    Settings::read(Some((name, text)), &[]).map_err(|faults| format!("not changed, it already has errors: {faults}"))?;
    let mut document = text.parse::<DocumentMut>().map_err(|error| format!("{name}: {error}"))?;
    for key in keys {
        put(&mut document, key, &key.value_text(wanted)).map_err(|what| format!("{name}: {}: {what}", key.name))?;
    }
    let edited = document.to_string();
    let read = Settings::read(Some((name, &edited)), &[]).map_err(|faults| faults.to_string())?;
    match keys.iter().find(|key| key.value_text(&read) != key.value_text(wanted)) {
        Some(key) => Err(format!("{name}: cannot write {}; edit the file by hand", key.name)),
        None => Ok(edited),
    }
}

/// Sets one key, in its section or under its full name, wherever the file has it; otherwise at the end of its section.
fn put(document: &mut DocumentMut, key: &Key, shown: &str) -> Result<(), String> {
    let mut value = shown.parse::<Value>().map_err(|error| format!("{shown}: {error}"))?;
    let root = document.as_table_mut();
    let section = root.entry(key.section()).or_insert_with(|| Item::Table(Table::new()));
    let Some(table) = section.as_table_like_mut() else { return Err("its section is not a table".into()) };
    match table.get_mut(key.short_name()).and_then(Item::as_value_mut) {
        Some(old) => {
            // The comment behind the value, and the spaces around it.
            *value.decor_mut() = old.decor().clone();
            *old = value;
        }
        None => {
            table.insert(key.short_name(), Item::Value(value));
        }
    }
    Ok(())
}

/// Writes the values that `keys` have in `wanted` to the file at `path`. The file is replaced atomically and keeps its owner and mode; a
/// link stays a link. Returns the path of the file that was written.
///
/// # Errors
/// A file that cannot be read, has errors, or cannot be written: then it is unchanged.
pub(super) fn write(path: &Path, keys: &[&Key], wanted: &Settings) -> Result<PathBuf, String> {
    let shown = path.display();
    let path = fs::canonicalize(path).map_err(|error| format!("{shown}: cannot open: {error}"))?;
    let about = fs::metadata(&path).map_err(|error| format!("{shown}: cannot read: {error}"))?;
    if !about.is_file() || about.len() > LARGEST {
        return Err(format!("{shown}: not a configuration file"));
    }
    let text = fs::read_to_string(&path).map_err(|error| format!("{shown}: cannot read: {error}"))?;
    let edited = edited(&shown.to_string(), &text, keys, wanted)?;
    replace(&path, &edited, &about).map_err(|error| {
        format!("{shown}: cannot write: {error}; add the lines below by hand, e.g. with `sudoedit {shown}`")
    })?;
    Ok(path)
}

fn replace(path: &Path, text: &str, about: &fs::Metadata) -> std::io::Result<()> {
    let directory = path.parent().unwrap_or(Path::new("/"));
    let mut file = tempfile::Builder::new().prefix(".gimbald-").suffix(".new").tempfile_in(directory)?;
    file.write_all(text.as_bytes())?;
    file.as_file().set_permissions(fs::Permissions::from_mode(about.mode() & 0o777))?;
    if (about.uid(), about.gid()) != (rustix::process::geteuid().as_raw(), rustix::process::getegid().as_raw()) {
        chown(file.path(), Some(about.uid()), Some(about.gid()))?;
    }
    file.as_file().sync_all()?;
    file.persist(path)?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::keys;

    fn with(sets: &[&str]) -> (Vec<&'static Key>, Settings) {
        let mut settings = Settings::default();
        sets.iter().for_each(|set| settings.set(set).unwrap());
        let keys = sets.iter().map(|set| keys::find(set.split('=').next().unwrap()).unwrap()).collect();
        (keys, settings)
    }

    #[test]
    fn comments_and_order_stay() {
        let before = "# mine\n[crop] # the window\nzoom = 1.2   # wide\n\n[smooth]\n# calm\nmode = \"iir\"\n";
        let (keys, wanted) = with(&["crop.zoom=1.3", "smooth.strength=0.5", "stabilize.enabled=false"]);
        let after = edited("g.toml", before, &keys, &wanted).unwrap();
        let expected = "# mine\n[crop] # the window\nzoom = 1.3   # wide\n\n[smooth]\n# calm\nmode = \"iir\"\nstrength = 0.5\n\n\
                        [stabilize]\nenabled = false\n";
        assert_eq!(after, expected);
    }

    #[test]
    fn keys_by_their_full_names_and_tables_in_a_line_are_found() {
        let (keys, wanted) = with(&["crop.zoom=1.3", "smooth.strength=0.5"]);
        let after = edited("g.toml", "crop.zoom = 1.1 # full\nsmooth = { strength = 1.0 }\n", &keys, &wanted).unwrap();
        assert_eq!(after, "crop.zoom = 1.3 # full\nsmooth = { strength = 0.5 }\n");
        let (keys, wanted) = with(&["crop.zoom=\"auto\""]);
        assert_eq!(edited("g.toml", "", &keys, &wanted).unwrap(), "[crop]\nzoom = \"auto\"\n");
    }

    #[test]
    fn a_file_with_errors_is_not_changed() {
        let scratch = tempfile::tempdir().unwrap();
        let path = scratch.path().join("g.toml");
        let (keys, wanted) = with(&["crop.zoom=1.3"]);
        assert!(write(&path, &keys, &wanted).unwrap_err().contains("cannot open"));
        fs::write(&path, "[crop]\nzoom = 77\n").unwrap();
        assert!(write(&path, &keys, &wanted).unwrap_err().contains("already has errors"));
        assert_eq!(fs::read_to_string(&path).unwrap(), "[crop]\nzoom = 77\n");
        let link = scratch.path().join("link.toml");
        std::os::unix::fs::symlink(&path, &link).unwrap();
        fs::write(&path, "[crop]\nzoom = 1.1\n").unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(0o640)).unwrap();
        assert_eq!(write(&link, &keys, &wanted).unwrap(), fs::canonicalize(&path).unwrap());
        assert_eq!(fs::read_to_string(&path).unwrap(), "[crop]\nzoom = 1.3\n");
        assert_eq!(fs::metadata(&path).unwrap().mode() & 0o777, 0o640);
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
    }
}
