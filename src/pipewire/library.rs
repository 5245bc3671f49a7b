//! libpipewire, opened at run time: the functions that a node needs, and whether what they need is installed.

use std::ffi::{CStr, c_char, c_int, c_void};
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use super::layout::{Dict, Opaque, PwBuffer, StreamEvents};

/// The library's name; the number is that of its interface, which has been the same since 2018.
const NAME: &CStr = c"libpipewire-0.3.so.0";

/// Without these libpipewire ends the process that calls it, or connects to nothing.
const PLUGIN: &str = "support/libspa-support.so";
const MODULE: &str = "libpipewire-module-protocol-native.so";

/// Why there is no PipeWire library here that could be used; each says what to install.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Missing {
    /// The library itself.
    #[error(
        "PipeWire's library is not installed ({0}); install it: sudo apt-get install libpipewire-0.3-0 libpipewire-0.3-modules pipewire"
    )]
    Library(String),
    /// One of its functions.
    #[error("PipeWire's library lacks the function {0}: it is older than version 0.3.40; update it")]
    Function(&'static str),
    /// What it needs.
    #[error(
        "PipeWire's library is installed without its plugins: {} is not there; install them: sudo apt-get install libspa-0.2-modules libpipewire-0.3-modules",
        .0.display()
    )]
    Plugins(PathBuf),
}

/// Declares the table of functions and the code that fills it.
macro_rules! functions {
    ($($name:ident: fn($($argument:ty),*) $(-> $result:ty)?;)*) => {
        /// libpipewire's functions; never closed, as the library's threads may outlive every object.
        #[derive(Debug)]
        pub struct Library {
            $(pub(super) $name: unsafe extern "C" fn($($argument),*) $(-> $result)?,)*
        }

        impl Library {
            fn filled(handle: *mut c_void) -> Result<Self, Missing> {
                Ok(Self {
                    $($name: {
                        let name = concat!("pw_", stringify!($name), "\0");
                        // SAFETY: `handle` came from dlopen and is never closed; the name ends in a zero.
                        let symbol = unsafe { libc::dlsym(handle, name.as_ptr().cast()) };
                        if symbol.is_null() {
                            return Err(Missing::Function(concat!("pw_", stringify!($name))));
                        }
                        // SAFETY: libpipewire-0.3.so.0 exports a function of this name with these arguments; its headers say so.
                        unsafe {
                            std::mem::transmute::<*mut c_void, unsafe extern "C" fn($($argument),*) $(-> $result)?>(symbol)
                        }
                    },)*
                })
            }
        }
    };
}

functions! {
    init: fn(*mut c_int, *mut *mut *mut c_char);
    get_library_version: fn() -> *const c_char;
    properties_new_dict: fn(*const Dict) -> *mut Opaque;
    thread_loop_new: fn(*const c_char, *const Dict) -> *mut Opaque;
    thread_loop_destroy: fn(*mut Opaque);
    thread_loop_get_loop: fn(*mut Opaque) -> *mut Opaque;
    thread_loop_start: fn(*mut Opaque) -> c_int;
    thread_loop_stop: fn(*mut Opaque);
    thread_loop_lock: fn(*mut Opaque);
    thread_loop_unlock: fn(*mut Opaque);
    stream_new_simple: fn(*mut Opaque, *const c_char, *mut Opaque, *const StreamEvents, *mut c_void) -> *mut Opaque;
    stream_destroy: fn(*mut Opaque);
    stream_connect: fn(*mut Opaque, c_int, u32, c_int, *const *const c_void, u32) -> c_int;
    stream_update_params: fn(*mut Opaque, *const *const c_void, u32) -> c_int;
    stream_dequeue_buffer: fn(*mut Opaque) -> *mut PwBuffer;
    stream_queue_buffer: fn(*mut Opaque, *mut PwBuffer) -> c_int;
    stream_trigger_process: fn(*mut Opaque) -> c_int;
}

impl Library {
    /// The library, opened and made ready with the first call; what is missing otherwise.
    ///
    /// # Errors
    /// [`Missing`]: what has to be installed.
    pub fn open() -> Result<&'static Self, Missing> {
        static OPENED: OnceLock<Result<Library, Missing>> = OnceLock::new();
        OPENED.get_or_init(Self::load).as_ref().map_err(Clone::clone)
    }

    fn load() -> Result<Self, Missing> {
        // SAFETY: the name ends in a zero; the library's initializers ask nothing of who loads it.
        let handle = unsafe { libc::dlopen(NAME.as_ptr(), libc::RTLD_NOW | libc::RTLD_LOCAL) };
        if handle.is_null() {
            // SAFETY: after a failure dlerror gives a text that ends in a zero and stays until this thread's next call of dl*.
            let why = unsafe { libc::dlerror().as_ref().map(|text| CStr::from_ptr(text).to_string_lossy().into_owned()) };
            return Err(Missing::Library(why.unwrap_or_default()));
        }
        let library = Self::filled(handle)?;
        plugins_beside(&library.path(), &|name| std::env::var_os(name).map(PathBuf::from))?;
        // SAFETY: null arguments are allowed: there are none.
        unsafe { (library.init)(std::ptr::null_mut(), std::ptr::null_mut()) };
        Ok(library)
    }

    /// The folder that the library lies in.
    fn path(&self) -> PathBuf {
        let mut info = libc::Dl_info {
            dli_fname: std::ptr::null(),
            dli_fbase: std::ptr::null_mut(),
            dli_sname: std::ptr::null(),
            dli_saddr: std::ptr::null_mut(),
        };
        // SAFETY: any address may be asked about; `info` is written to.
        let found = unsafe { libc::dladdr(self.init as *const c_void, &mut info) };
        if found == 0 || info.dli_fname.is_null() {
            return PathBuf::from("/usr/lib");
        }
        // SAFETY: dladdr succeeded: the name ends in a zero and lasts as long as the library is loaded, which is until the process ends.
        let name = unsafe { CStr::from_ptr(info.dli_fname) };
        Path::new(&*name.to_string_lossy()).parent().unwrap_or(Path::new("/usr/lib")).to_path_buf()
    }

    /// The library's version, as "0.3.65".
    pub fn version(&self) -> String {
        // SAFETY: the library gives a text of its own that ends in a zero and lasts as long as it.
        unsafe { CStr::from_ptr((self.get_library_version)()) }.to_string_lossy().into_owned()
    }
}

/// Whether the plugins and modules are there that libpipewire in the folder `place` will load; `variable` reads the environment, which
/// may name other folders.
fn plugins_beside(place: &Path, variable: &dyn Fn(&str) -> Option<PathBuf>) -> Result<(), Missing> {
    for (name, folder, file) in [("SPA_PLUGIN_DIR", "spa-0.2", PLUGIN), ("PIPEWIRE_MODULE_DIR", "pipewire-0.3", MODULE)] {
        let folders = variable(name)
            .map_or_else(|| vec![place.join(folder)], |folders| std::env::split_paths(&folders).collect::<Vec<_>>());
        if !folders.iter().any(|folder| folder.join(file).is_file()) {
            let first = folders.into_iter().next().unwrap_or_else(|| place.join(folder));
            return Err(Missing::Plugins(first.join(file)));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn plugins_are_looked_for_beside_the_library_or_where_the_environment_says() {
        let root = std::env::temp_dir().join(format!("gimbald-plugins-{}", std::process::id()));
        let put = |file: &str| {
            let path = root.join(file);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, "").unwrap();
        };
        let nothing = |_: &str| None;
        assert_eq!(plugins_beside(&root, &nothing), Err(Missing::Plugins(root.join("spa-0.2").join(PLUGIN))));
        put("spa-0.2/support/libspa-support.so");
        assert_eq!(plugins_beside(&root, &nothing), Err(Missing::Plugins(root.join("pipewire-0.3").join(MODULE))));
        put("pipewire-0.3/libpipewire-module-protocol-native.so");
        assert_eq!(plugins_beside(&root, &nothing), Ok(()));
        let elsewhere = |name: &str| (name == "SPA_PLUGIN_DIR").then(|| PathBuf::from("/no/such/folder"));
        let missing = plugins_beside(&root, &elsewhere).unwrap_err().to_string();
        assert!(missing.contains("/no/such/folder") && missing.contains("apt-get install"), "{missing}");
        let _ = std::fs::remove_dir_all(&root);
    }
}
