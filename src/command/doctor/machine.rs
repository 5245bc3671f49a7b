//! What the kernel reports in files (/sys, /proc, /lib/modules), below a root directory that tests can replace.

use std::fs;
use std::path::{Path, PathBuf};

/// Who holds a device open.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Holder {
    /// Process.
    pub pid: u32,
    /// Its name.
    pub name: String,
}

/// The files of a machine.
#[derive(Clone, Debug)]
pub struct Machine {
    root: PathBuf,
}

impl Machine {
    /// The machine whose root directory is `root`.
    pub fn at(root: &Path) -> Self {
        Self { root: root.into() }
    }

    /// The content of a small file, without the line end; `None` where there is none.
    fn text(&self, path: &str) -> Option<String> {
        fs::read_to_string(self.root.join(path)).ok().map(|text| text.trim_end().to_owned())
    }

    /// Version of the v4l2loopback that is loaded.
    pub fn loopback_version(&self) -> Option<String> {
        let loaded = self.root.join("sys/module/v4l2loopback").is_dir();
        loaded.then(|| self.text("sys/module/v4l2loopback/version").unwrap_or_default())
    }

    /// A parameter of the v4l2loopback that is loaded.
    pub fn loopback_parameter(&self, name: &str) -> Option<String> {
        self.text(&format!("sys/module/v4l2loopback/parameters/{name}"))
    }

    /// Whether modprobe would find v4l2loopback for the kernel that runs.
    pub fn has_loopback_module(&self) -> bool {
        let Some(release) = self.text("proc/sys/kernel/osrelease") else { return false };
        let listed = self.text(&format!("lib/modules/{release}/modules.dep"));
        listed.is_some_and(|modules| modules.contains("/v4l2loopback.ko"))
    }

    /// The format that a loopback device has, as "YUYV:640x480@30"; `None` where it has none, or does not tell.
    pub fn loopback_format(&self, device: &Path) -> Option<String> {
        let name = device.file_name()?.to_str()?;
        self.text(&format!("sys/devices/virtual/video4linux/{name}/format")).filter(|format| !format.is_empty())
    }

    /// Who holds `device` open, and whether every process could be looked at.
    pub fn holders(&self, device: &Path) -> (Vec<Holder>, bool) {
        let (mut holders, mut all) = (Vec::new(), true);
        for entry in fs::read_dir(self.root.join("proc")).into_iter().flatten().flatten() {
            let Some(pid) = entry.file_name().to_str().and_then(|name| name.parse().ok()) else { continue };
            let Ok(descriptors) = fs::read_dir(entry.path().join("fd")) else {
                // A process that has ended meanwhile is no secret.
                all &= !entry.path().is_dir();
                continue;
            };
            let held = |link: fs::DirEntry| fs::read_link(link.path()).is_ok_and(|target| target == device);
            if descriptors.flatten().any(held) {
                let name = fs::read_to_string(entry.path().join("comm")).unwrap_or_default().trim_end().to_owned();
                holders.push(Holder { pid, name });
            }
        }
        holders.sort_by_key(|holder| holder.pid);
        (holders, all)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::symlink;

    #[test]
    fn files_are_read_as_the_kernel_writes_them() {
        let root = std::env::temp_dir().join(format!("gimbald-machine-{}", std::process::id()));
        let put = |path: &str, text: &str| {
            let path = root.join(path);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, text).unwrap();
        };
        let machine = Machine::at(&root);
        assert_eq!((machine.loopback_version(), machine.has_loopback_module()), (None, false));
        put("sys/module/v4l2loopback/version", "0.15.0\n");
        put("sys/module/v4l2loopback/parameters/max_buffers", "2\n");
        put("sys/devices/virtual/video4linux/video7/format", "YUYV:640x480@30\n");
        put("sys/devices/virtual/video4linux/video8/format", "\n");
        put("proc/sys/kernel/osrelease", "6.1.0\n");
        put("lib/modules/6.1.0/modules.dep", "updates/dkms/v4l2loopback.ko.xz: kernel/drivers/media/videodev.ko.xz\n");
        put("proc/12/comm", "zoom\n");
        fs::create_dir_all(root.join("proc/12/fd")).unwrap();
        symlink("/dev/video7", root.join("proc/12/fd/3")).unwrap();
        symlink("/dev/null", root.join("proc/12/fd/4")).unwrap();
        fs::create_dir_all(root.join("proc/13")).unwrap();
        let device = Path::new("/dev/video7");
        assert_eq!(machine.loopback_version().as_deref(), Some("0.15.0"));
        assert_eq!(machine.loopback_parameter("max_buffers").as_deref(), Some("2"));
        assert_eq!(machine.loopback_format(device).as_deref(), Some("YUYV:640x480@30"));
        assert_eq!(machine.loopback_format(Path::new("/dev/video8")), None);
        assert!(machine.has_loopback_module());
        assert_eq!(machine.holders(device), (vec![Holder { pid: 12, name: "zoom".into() }], false), "13 cannot be looked at");
        let _ = fs::remove_dir_all(&root);
    }
}
