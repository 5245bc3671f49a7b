//! Pictures lent to companions: who gets them, what a hostile companion can do, what the frame path does meanwhile.

use std::fs::{File, OpenOptions};
use std::io::IoSlice;
use std::mem::MaybeUninit;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use gimbald::device::StreamFormat;
use gimbald::frame::{Frame, Stamp};
use gimbald::image::{Picture, PixelFormat, Sampling};
use gimbald::rt::notifier::Notifier;
use gimbald::share::{Client, Companions, Format, Heard, Memory, Outlet, Pair, Refusal, Server};
use rustix::fs::{MemfdFlags, SealFlags, fcntl_add_seals, ftruncate, memfd_create};
use rustix::net::{
    AddressFamily, SendAncillaryBuffer, SendAncillaryMessage, SendFlags, SocketAddrUnix, SocketFlags, SocketType, connect,
    sendmsg, socket_with,
};

const SIZE: (u32, u32) = (64, 48);
const BYTES: usize = 2 * 64 * 48;

/// A device that every user may open stands for the camera.
const CAMERA: &str = "/dev/null";

/// A server in a thread, in a folder of its own.
struct Rig {
    folder: PathBuf,
    companions: Companions,
    done: Notifier,
    thread: Option<std::thread::JoinHandle<()>>,
}

impl Rig {
    fn new(name: &str, camera: Option<&'static str>) -> Self {
        let folder = std::env::temp_dir().join(format!("gimbald-share-{}-{name}", std::process::id()));
        let server = Server::open(&folder).unwrap();
        let (companions, done) = (server.companions().clone(), Notifier::new().unwrap());
        let notifier = done.clone();
        let thread = std::thread::spawn(move || server.serve(&notifier, &|| camera.map(PathBuf::from)));
        Self { folder, companions, done, thread: Some(thread) }
    }

    fn path(&self) -> PathBuf {
        self.folder.join("pictures.sock")
    }

    fn outlet(&self) -> Outlet {
        let outlet = self.companions.outlet(&format());
        self.companions.camera_is(Path::new(CAMERA));
        outlet
    }

    fn client(&self) -> Client {
        Client::connect(&self.path()).unwrap()
    }
}

impl Drop for Rig {
    fn drop(&mut self) {
        self.done.notify();
        self.thread.take().unwrap().join().unwrap();
        assert!(!self.path().exists(), "the socket goes with its server");
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

fn format() -> StreamFormat {
    StreamFormat::tight(SIZE.0, SIZE.1, PixelFormat::I420, (1, 30))
}

fn camera() -> File {
    OpenOptions::new().read(true).write(true).open(CAMERA).unwrap()
}

fn memfd(size: usize, seals: SealFlags) -> OwnedFd {
    let fd = memfd_create(c"test", MemfdFlags::CLOEXEC | MemfdFlags::ALLOW_SEALING).unwrap();
    ftruncate(&fd, size as u64).unwrap();
    fcntl_add_seals(&fd, seals).unwrap();
    fd
}

fn picture(luma: u8) -> Picture {
    let mut picture = Picture::new(Sampling::S420, SIZE.0 as usize, SIZE.1 as usize);
    let mut canvas = picture.as_mut();
    for plane in &mut canvas.planes {
        (0..plane.height()).for_each(|y| plane.row_mut(y).fill(luma));
    }
    picture
}

fn until(what: &str, mut is_so: impl FnMut() -> bool) {
    let before = Instant::now();
    while !is_so() {
        assert!(before.elapsed() < Duration::from_secs(20), "{what} within 20 seconds");
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// The next thing that is heard, however long it takes.
fn heard(client: &Client) -> std::io::Result<Heard> {
    let before = Instant::now();
    loop {
        match client.receive() {
            Ok(Some(heard)) => return Ok(heard),
            Ok(None) => std::thread::sleep(Duration::from_millis(2)),
            Err(error) => return Err(error),
        }
        assert!(before.elapsed() < Duration::from_secs(20), "nothing was heard");
    }
}

/// What comes after the formats that the daemon tells.
fn answer(client: &Client) -> std::io::Result<Heard> {
    loop {
        match heard(client)? {
            Heard::Format(_) => {}
            other => return Ok(other),
        }
    }
}

/// A connection that has lent `count` pieces of memory and proved itself.
fn lending(rig: &Rig, count: u64) -> (Client, Vec<Memory>) {
    let client = rig.client();
    client.watch(true, SIZE, Some(camera().as_fd())).unwrap();
    let memory = (0..count)
        .map(|id| {
            let fd = memfd(BYTES, SealFlags::SHRINK);
            client.lend(id, fd.as_fd()).unwrap();
            client.free(id).unwrap();
            Memory::map(&fd, BYTES).unwrap()
        })
        .collect();
    (client, memory)
}

#[test]
fn a_picture_is_drawn_into_lent_memory_and_waits_until_it_is_free_again() {
    let rig = Rig::new("draws", None);
    let mut outlet = rig.outlet();
    let (client, memory) = lending(&rig, 2);
    until("it watches", || rig.companions.watching() == 1 && outlet.is_wanted());
    assert_eq!(rig.companions.held_size(), Some(SIZE));
    // Both pieces are taken once the server has heard of them.
    let mut drawn = Vec::new();
    until("both are drawn into", || {
        outlet.send(picture(50 + drawn.len() as u8).as_ref(), &Stamp { time_ns: 7, ..Stamp::default() });
        while let Ok(Some(said)) = client.receive() {
            if let Heard::Frame { id, time_ns: 7 } = said {
                drawn.push(id);
            }
        }
        drawn.len() == 2
    });
    assert_ne!(drawn[0], drawn[1]);
    for (luma, id) in [50, 51].into_iter().zip(&drawn) {
        assert_eq!(memory[*id as usize].bytes()[0], luma, "YUYV begins with luma");
    }
    // Nothing is drawn into what is being shown.
    outlet.send(picture(90).as_ref(), &Stamp::default());
    std::thread::sleep(Duration::from_millis(50));
    assert_eq!(client.receive().unwrap(), None);
    assert!(memory.iter().all(|memory| memory.bytes()[0] < 90));
    client.free(drawn[0]).unwrap();
    until("the piece that was freed is drawn into", || {
        outlet.send(picture(91).as_ref(), &Stamp::default());
        matches!(client.receive(), Ok(Some(Heard::Frame { id, .. })) if id == drawn[0])
    });
    assert_eq!(memory[drawn[0] as usize].bytes()[0], 91);
    // What is revoked is drawn into no more.
    client.free(drawn[0]).unwrap();
    client.revoke(drawn[0]).unwrap();
    client.free(drawn[1]).unwrap();
    until("the other piece is drawn into", || {
        outlet.send(picture(92).as_ref(), &Stamp::default());
        matches!(client.receive(), Ok(Some(Heard::Frame { id, .. })) if id == drawn[1])
    });
    assert_eq!(memory[drawn[0] as usize].bytes()[0], 91);
    client.watch(false, SIZE, None).unwrap();
    until("no program watches", || rig.companions.watching() == 0 && !outlet.is_wanted());
    drop(client);
    until("it is gone", || rig.companions.connected() == 0);
}

#[test]
fn a_companion_that_may_not_open_the_camera_gets_nothing() {
    let rig = Rig::new("proof", None);
    let mut outlet = rig.outlet();
    let read_only = File::open(CAMERA).unwrap();
    let other = OpenOptions::new().read(true).write(true).open("/dev/zero").unwrap();
    let path_only = rustix::fs::open(CAMERA, rustix::fs::OFlags::PATH, rustix::fs::Mode::empty()).unwrap();
    let (pipe, _writer) = std::io::pipe().unwrap();
    let proofs: [Option<BorrowedFd<'_>>; 5] =
        [None, Some(read_only.as_fd()), Some(other.as_fd()), Some(path_only.as_fd()), Some(pipe.as_fd())];
    for (number, proof) in proofs.into_iter().enumerate() {
        let client = rig.client();
        client.watch(true, SIZE, proof).unwrap();
        assert_eq!(answer(&client).unwrap(), Heard::Refused(Refusal::Proof), "proof {number}");
        let fd = memfd(BYTES, SealFlags::SHRINK);
        client.lend(1, fd.as_fd()).unwrap();
        client.free(1).unwrap();
        std::thread::sleep(Duration::from_millis(20));
        assert!(!outlet.is_wanted() && rig.companions.watching() == 0, "proof {number}");
        outlet.send(picture(77).as_ref(), &Stamp::default());
        assert_eq!(client.receive().unwrap(), None, "proof {number}");
        assert_eq!(Memory::map(&fd, BYTES).unwrap().bytes()[0], 0, "proof {number}");
        // With the right one it does.
        client.watch(true, SIZE, Some(camera().as_fd())).unwrap();
        until("it watches", || rig.companions.watching() == 1);
        // A proof counts for one visit, not for ever.
        client.watch(true, SIZE, proof).unwrap();
        until("it watches no more", || rig.companions.watching() == 0);
    }
}

#[test]
fn another_camera_asks_for_another_proof() {
    let rig = Rig::new("other", None);
    let mut outlet = rig.outlet();
    let (client, _memory) = lending(&rig, 1);
    until("it watches", || outlet.is_wanted());
    rig.companions.camera_is(Path::new("/dev/zero"));
    until("it must prove itself again", || rig.companions.watching() == 0 && !outlet.is_wanted());
    let said = heard(&client).unwrap();
    assert!(matches!(said, Heard::Format(Format { ref camera, .. }) if camera == Path::new(CAMERA)), "{said:?}");
    let told = || matches!(heard(&client).unwrap(), Heard::Format(Format { camera, .. }) if camera == Path::new("/dev/zero"));
    until("it is told of the other one", told);
}

#[test]
fn a_camera_that_was_not_there_is_looked_for_while_a_companion_waits_for_it() {
    let rig = Rig::new("looked-for", Some(CAMERA));
    let _outlet = rig.companions.outlet(&format());
    let client = rig.client();
    let Heard::Format(first) = heard(&client).unwrap() else { panic!("no format") };
    assert_eq!(first.camera, Path::new(""), "it is not known yet");
    client.watch(true, SIZE, None).unwrap();
    assert_eq!(heard(&client).unwrap(), Heard::Refused(Refusal::Proof));
    let Heard::Format(second) = heard(&client).unwrap() else { panic!("no format") };
    assert_eq!(second.camera, Path::new(CAMERA));
    client.watch(true, SIZE, Some(camera().as_fd())).unwrap();
    until("it watches", || rig.companions.watching() == 1);
}

#[test]
fn readers_of_another_size_are_counted_and_get_nothing() {
    let rig = Rig::new("size", None);
    let mut outlet = rig.outlet();
    let client = rig.client();
    client.watch(true, (32, 24), Some(camera().as_fd())).unwrap();
    assert_eq!(answer(&client).unwrap(), Heard::Refused(Refusal::Size));
    until("it watches", || rig.companions.watching() == 1);
    assert_eq!(rig.companions.held_size(), Some((32, 24)));
    assert!(!outlet.is_wanted());
    // The daemon makes its pictures as they hold them.
    let mut smaller = rig.companions.outlet(&StreamFormat::tight(32, 24, PixelFormat::I420, (1, 30)));
    until("it gets pictures", || smaller.is_wanted());
}

/// A page of `gimbald view` and the memory that it lends.
fn page(rig: &Rig, proof: Option<BorrowedFd<'_>>) -> (Client, Pair) {
    let client = rig.client();
    client.watch_both(SIZE, proof).unwrap();
    let (pair, memory) = Pair::new(SIZE.0, SIZE.1).unwrap();
    client.lend(1, memory.as_fd()).unwrap();
    client.free(1).unwrap();
    (client, pair)
}

#[test]
fn a_page_gets_output_and_input_and_does_not_hold_the_size() {
    let rig = Rig::new("page", None);
    let mut outlet = rig.outlet();
    let mut inspector = rig.companions.inspector(&format());
    let (client, pair) = page(&rig, Some(camera().as_fd()));
    until("it watches", || rig.companions.watching() == 1);
    assert_eq!((rig.companions.pages(), rig.companions.held_size(), outlet.is_wanted()), (1, None, false));
    let frame = Frame { picture: picture(40), ..Frame::default() };
    until("a pair comes", || {
        inspector.show(&frame, picture(200).as_ref());
        matches!(client.receive(), Ok(Some(Heard::Frame { id: 1, .. })))
    });
    assert_eq!((pair.output()[0], pair.input()[0]), (200, 40));
    let known = pair.frames();
    // Nothing is drawn until the memory is free again, and no frame is missing then.
    let darker = picture(10);
    (0..5).for_each(|_| inspector.show(&frame, darker.as_ref()));
    assert_eq!((pair.output()[0], client.receive().unwrap()), (200, None));
    client.free(1).unwrap();
    until("the next pair comes", || {
        inspector.show(&frame, darker.as_ref());
        matches!(client.receive(), Ok(Some(Heard::Frame { id: 1, .. })))
    });
    let next = pair.frames();
    assert_eq!(pair.output()[0], 10);
    assert!(next.last().unwrap().number >= known.last().unwrap().number + 6);
    assert!(next.windows(2).all(|two| two[1].number == two[0].number + 1));
    // Its number of frames goes on while a program watches as well, whose size counts.
    let (program, _memory) = lending(&rig, 1);
    until("both watch", || rig.companions.watching() == 2);
    assert_eq!((rig.companions.pages(), rig.companions.held_size()), (1, Some(SIZE)));
    drop((client, program));
    until("both are gone", || rig.companions.watching() == 0 && rig.companions.pages() == 0);
}

#[test]
fn a_page_of_a_user_who_may_not_open_the_camera_gets_nothing() {
    let rig = Rig::new("page-proof", None);
    let _outlet = rig.outlet();
    let mut inspector = rig.companions.inspector(&format());
    let read_only = File::open(CAMERA).unwrap();
    let frame = Frame { picture: picture(40), ..Frame::default() };
    for proof in [None, Some(read_only.as_fd())] {
        let (client, pair) = page(&rig, proof);
        assert_eq!(answer(&client).unwrap(), Heard::Refused(Refusal::Proof));
        std::thread::sleep(Duration::from_millis(20));
        inspector.show(&frame, picture(200).as_ref());
        assert_eq!((client.receive().unwrap(), rig.companions.pages()), (None, 0));
        assert!(pair.output().iter().chain(pair.input()).all(|byte| *byte == 0));
    }
    // Memory of one picture is too small for a pair.
    let client = rig.client();
    client.watch_both(SIZE, Some(camera().as_fd())).unwrap();
    client.lend(1, memfd(BYTES, SealFlags::SHRINK).as_fd()).unwrap();
    until("it is disconnected", || client.receive().is_err());
}

/// Sends bytes and descriptors as no honest companion does.
fn raw(rig: &Rig) -> OwnedFd {
    let socket = socket_with(AddressFamily::UNIX, SocketType::SEQPACKET, SocketFlags::CLOEXEC, None).unwrap();
    connect(&socket, &SocketAddrUnix::new(rig.path()).unwrap()).unwrap();
    socket
}

fn throw(socket: &OwnedFd, bytes: &[u8], fds: &[BorrowedFd<'_>]) -> bool {
    let mut space = [MaybeUninit::uninit(); rustix::cmsg_space!(ScmRights(253))];
    let mut ancillary = SendAncillaryBuffer::new(&mut space);
    if !fds.is_empty() {
        assert!(ancillary.push(SendAncillaryMessage::ScmRights(fds)));
    }
    sendmsg(socket, &[IoSlice::new(bytes)], &mut ancillary, SendFlags::NOSIGNAL | SendFlags::DONTWAIT).is_ok()
}

fn is_hung_up(socket: &OwnedFd) -> bool {
    let before = Instant::now();
    while before.elapsed() < Duration::from_secs(10) {
        if is_hung_up_now(socket) {
            return true;
        }
        std::thread::sleep(Duration::from_millis(2));
    }
    false
}

/// Formats that were told come first.
fn is_hung_up_now(socket: &OwnedFd) -> bool {
    let mut bytes = [0; 512];
    loop {
        match rustix::net::recv(socket, &mut bytes, rustix::net::RecvFlags::DONTWAIT) {
            Ok((0, _)) | Err(rustix::io::Errno::CONNRESET) => return true,
            Ok(_) => {}
            Err(_) => return false,
        }
    }
}

fn message(tag: u32, rest: &[u8]) -> Vec<u8> {
    [&(1 << 16 | tag).to_le_bytes(), rest].concat()
}

#[test]
fn nonsense_ends_the_connection_and_nothing_else() {
    let rig = Rig::new("nonsense", None);
    let mut outlet = rig.outlet();
    let (honest, memory) = lending(&rig, 2);
    until("the honest one watches", || outlet.is_wanted());
    let watch = message(16, &[1, 0, 0, 0, 64, 0, 0, 0, 48, 0, 0, 0]);
    let lend = message(17, &[0; 8]);
    let (null, good) = (camera(), memfd(BYTES, SealFlags::SHRINK));
    let unsealed = memfd(BYTES, SealFlags::empty());
    let small = memfd(BYTES - 1, SealFlags::SHRINK);
    let fixed = memfd(BYTES, SealFlags::SHRINK | SealFlags::WRITE);
    let many: Vec<BorrowedFd<'_>> = (0..253).map(|_| null.as_fd()).collect();
    let huge = message(16, &[1, 0, 0, 0, 0xfe, 0xff, 0xff, 0xff, 0xfe, 0xff, 0xff, 0xff]);
    type Thrown<'a> = (Vec<u8>, Vec<BorrowedFd<'a>>);
    let attacks: Vec<(&str, Vec<Thrown<'_>>)> = vec![
        ("no message", vec![(vec![1, 2, 3], vec![])]),
        ("an unknown tag", vec![(message(99, &[]), vec![])]),
        ("too long", vec![(vec![0; 5000], vec![])]),
        ("a hundred descriptors", vec![(watch.clone(), many.clone())]),
        ("descriptors with nonsense", vec![(vec![9], many)]),
        ("memory before the size", vec![(lend.clone(), vec![good.as_fd()])]),
        ("memory of an impossible size", vec![(huge, vec![]), (lend.clone(), vec![good.as_fd()])]),
        ("memory that can shrink", vec![(watch.clone(), vec![]), (lend.clone(), vec![unsealed.as_fd()])]),
        ("memory that is too small", vec![(watch.clone(), vec![]), (lend.clone(), vec![small.as_fd()])]),
        ("memory that cannot be written", vec![(watch.clone(), vec![]), (lend.clone(), vec![fixed.as_fd()])]),
        ("a device for memory", vec![(watch.clone(), vec![]), (lend.clone(), vec![null.as_fd()])]),
        ("no memory", vec![(watch.clone(), vec![]), (lend.clone(), vec![])]),
        (
            "the same number twice",
            vec![(watch.clone(), vec![]), (lend.clone(), vec![good.as_fd()]), (lend.clone(), vec![good.as_fd()])],
        ),
        ("a descriptor with what wants none", vec![(message(18, &[0; 8]), vec![good.as_fd()])]),
    ];
    for (what, thrown) in attacks {
        let socket = raw(&rig);
        for (bytes, fds) in &thrown {
            throw(&socket, bytes, fds);
        }
        assert!(is_hung_up(&socket), "{what}");
    }
    let socket = raw(&rig);
    throw(&socket, &watch, &[]);
    let lent = (0..40u64).take_while(|id| throw(&socket, &message(17, &id.to_le_bytes()), &[good.as_fd()])).count();
    assert!(lent > 16 && is_hung_up(&socket), "more memory than there are buffers");
    let socket = raw(&rig);
    let mut sent = 0;
    until("a flood ends", || {
        sent += (0..100).filter(|_| throw(&socket, &message(18, &[0; 8]), &[])).count();
        sent > 1000 && is_hung_up_now(&socket)
    });
    // No other companion noticed.
    until("the honest one gets its pictures", || {
        outlet.send(picture(66).as_ref(), &Stamp::default());
        matches!(answer(&honest).unwrap(), Heard::Frame { id, .. } if memory[id as usize].bytes()[0] == 66)
    });
}

#[test]
fn a_companion_that_does_not_read_delays_no_other() {
    let rig = Rig::new("deaf", None);
    let mut outlet = rig.outlet();
    let (deaf, _memory) = lending(&rig, 16);
    until("it watches", || outlet.is_wanted());
    // It frees what it never heard of, so that there is always memory, until its socket is full.
    let picture = picture(10);
    let before = Instant::now();
    for frame in 0..5000u64 {
        outlet.send(picture.as_ref(), &Stamp::default());
        if frame % 4 == 0 {
            let _ = deaf.free(frame / 4 % 16);
        }
    }
    assert!(before.elapsed() < Duration::from_secs(20), "5000 frames were held up");
}

#[test]
fn the_places_are_for_those_who_prove_themselves() {
    let rig = Rig::new("places", None);
    let mut outlet = rig.outlet();
    let idle: Vec<OwnedFd> = (0..8).map(|_| raw(&rig)).collect();
    until("all places are taken", || rig.companions.connected() == 8);
    let (honest, _memory) = lending(&rig, 1);
    until("the honest one has a place all the same", || outlet.is_wanted());
    assert!(idle.iter().filter(|socket| is_hung_up_now(socket)).count() >= 1);
    let more: Vec<OwnedFd> = (0..20).map(|_| raw(&rig)).collect();
    std::thread::sleep(Duration::from_millis(50));
    assert!(rig.companions.connected() <= 8);
    assert_eq!(rig.companions.watching(), 1, "and keeps it");
    drop((honest, more));
    until("it left", || rig.companions.watching() == 0);
}

#[test]
fn a_second_daemon_takes_the_socket_over_and_the_first_leaves_it_alone() {
    let first = Rig::new("twice", None);
    let outlet = first.outlet();
    let second = Server::open(&first.folder).unwrap();
    drop(outlet);
    let path = first.path();
    assert!(path.exists());
    let client = Client::connect(&path).unwrap();
    first.done.notify();
    let companions = second.companions().clone();
    let done = Notifier::new().unwrap();
    let notifier = done.clone();
    let thread = std::thread::spawn(move || second.serve(&notifier, &|| None));
    until("the second has it", || companions.connected() == 1);
    drop(client);
    done.notify();
    thread.join().unwrap();
}
