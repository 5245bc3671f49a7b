//! Many clients and bad ones: whoever asks modestly is answered, whatever the others do.

use std::io::{ErrorKind, Read, Write};
use std::os::unix::net::UnixStream;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering::Relaxed};
use std::sync::{Arc, Mutex, mpsc};
use std::time::{Duration, Instant};

use gimbald::command::Exit;
use gimbald::config::Settings;
use gimbald::control::{Connection, Limits, Rate, RefusalKind, Reply};
use rustix::process::Uid;

use crate::rig::{LONG, Scratch, reply, said, served, served_with, skipped};

/// Limits under which nothing but the number of places decides.
fn unlimited() -> Limits {
    let without_end = Rate { per_second: 1e6, burst: 1e6 };
    Limits { idle: 10 * LONG, slow: 10 * LONG, process: without_end, user: without_end, ..Limits::default() }
}

/// Whether the daemon has hung up; what it said before is passed over.
fn hung_up(mut stream: &UnixStream) -> bool {
    let mut buffer = [0; 1024];
    loop {
        match stream.read(&mut buffer) {
            Ok(0) => return true,
            Ok(_) => {}
            Err(error) => return error.kind() == ErrorKind::ConnectionReset,
        }
    }
}

/// Connects as another user; `None` where that is not allowed here.
fn connect_as(scratch: &Scratch, uid: u32) -> Option<UnixStream> {
    let path = scratch.socket();
    std::thread::spawn(move || {
        // The system call changes this thread alone, which ends with it.
        rustix::thread::set_thread_res_uid(None, Uid::from_raw(uid), None).ok()?;
        let stream = UnixStream::connect(path).unwrap();
        stream.set_read_timeout(Some(LONG)).unwrap();
        Some(stream)
    })
    .join()
    .unwrap()
}

#[test]
fn bad_company_keeps_nobody_waiting() {
    served("company", unlimited(), |scratch, state| {
        // one who never ends a line, one who is silent, one who asks and never listens
        let mut endless = scratch.connect();
        endless.write_all(&[b'x'; 100]).unwrap();
        let _silent = scratch.connect();
        let deaf = scratch.connect();
        deaf.set_nonblocking(true).unwrap();
        let mut asked = 0;
        while asked < 4_000_000 {
            match (&deaf).write(&b"status\n".repeat(500)) {
                Ok(written) => asked += written,
                Err(_) => break,
            }
        }
        assert!(asked < 4_000_000, "what the deaf one asks is not taken without end");
        for _ in 0..20 {
            let status = Connection::open(&scratch.socket()).unwrap().status().unwrap();
            assert_eq!(status.pid, std::process::id());
        }
        assert!(state.live.params().enabled);
    });
}

/// Sixteen connections of one process ask without end; programs of the same user are answered, and the sixteen get their share.
#[test]
fn a_flood_leaves_others_their_turn() {
    served("flood", Limits::default(), |scratch, _| {
        let over = AtomicBool::new(false);
        let answered = AtomicUsize::new(0);
        let begun = Instant::now();
        // All connect before any asks: a process that asks too much is refused more connections.
        let streams: Vec<UnixStream> = (0..16).map(|_| scratch.connect()).collect();
        let elapsed = std::thread::scope(|scope| {
            for stream in &streams {
                scope.spawn(|| flood(stream, b"set a=\n", &over, &answered));
            }
            while answered.load(Relaxed) < 100 {
                std::thread::sleep(Duration::from_millis(5));
            }
            for _ in 0..10 {
                assert!(said(&scratch.gimbald(&["status"])).contains("state "));
                assert_eq!(said(&scratch.gimbald(&["reload"])), "reloaded, no changes\n");
            }
            over.store(true, Relaxed);
            begun.elapsed().as_secs_f64()
        });
        // what is answered later than that is more time, not more a second
        let Rate { per_second, burst } = Limits::default().process;
        let most = burst + per_second * (elapsed + begun.elapsed().as_secs_f64());
        let answered = answered.load(Relaxed) as f64;
        assert!(answered <= most, "{answered} answers in {elapsed} s");
    });
}

/// Asks `line` as fast as it is taken, and counts the answers.
fn flood(stream: &UnixStream, line: &[u8], over: &AtomicBool, answered: &AtomicUsize) {
    stream.set_nonblocking(true).unwrap();
    let lines = line.repeat(800);
    let mut buffer = [0; 65_536];
    while !over.load(Relaxed) {
        let _ = (&*stream).write(&lines);
        match (&*stream).read(&mut buffer) {
            Ok(0) => panic!("hung up on"),
            Ok(read) => {
                answered.fetch_add(buffer[..read].iter().filter(|byte| **byte == b'\n').count(), Relaxed);
            }
            Err(error) if error.kind() == ErrorKind::WouldBlock => std::thread::sleep(Duration::from_millis(1)),
            Err(error) => panic!("{error}"),
        }
    }
}

#[test]
fn who_asks_without_end_waits_for_his_answers_and_gets_them_all() {
    let limits = Limits { connection: Rate { per_second: 20.0, burst: 20.0 }, ..unlimited() };
    served("pace", limits, |scratch, _| {
        let stream = scratch.connect();
        let begun = Instant::now();
        for _ in 0..3 {
            // more at once than are given at once
            (&stream).write_all(&b"status\n".repeat(20)).unwrap();
            assert!((0..20).all(|_| matches!(reply(&stream), Reply::Status { .. })));
        }
        // sixty answers, the first twenty at once and then twenty a second: never sooner, on however slow a machine
        assert!(begun.elapsed() >= Duration::from_millis(1900), "{:?}", begun.elapsed());
    });
}

/// Connections that ask nothing cost nobody a place: neither seventeen nor two hundred.
#[test]
fn idle_connections_make_room() {
    served("idle", unlimited(), |scratch, _| {
        let mut idle: Vec<UnixStream> = (0..17).map(|_| scratch.connect()).collect();
        assert!(said(&scratch.gimbald(&["status"])).contains("state "));
        // the seventeenth of this process took the place of the first, which was told so
        let Reply::Refused(refusal) = reply(&idle[0]) else { panic!("not refused") };
        assert!(refusal.kind == RefusalKind::Busy && refusal.error.contains("in favour of another client"), "{refusal:?}");
        assert!(hung_up(&idle[0]));
        // those that are left are served
        for stream in &mut idle[1..] {
            stream.write_all(b"status\n").unwrap();
            assert!(matches!(reply(stream), Reply::Status { .. }));
        }
        idle.extend((0..200).map(|_| scratch.connect()));
        assert!(said(&scratch.gimbald(&["status"])).contains("state "));
        assert!(hung_up(&idle[100]));
    });
}

/// The same by many users, who fill all places that they may have.
#[test]
fn places_are_kept_for_root_and_the_own_user() {
    let scratch = Scratch::new("kept");
    if connect_as_is_impossible(&scratch) {
        return skipped("places kept for root: only root can connect as others");
    }
    let read = || Ok(Settings::default());
    // The process limit would count here as well: all these users have one process.
    let limits = Limits { per_process: 64, ..unlimited() };
    served_with(scratch, 0o666, limits, Box::new(read), |scratch, _| {
        std::fs::set_permissions(&scratch.0, std::os::unix::fs::PermissionsExt::from_mode(0o755)).unwrap();
        let others: Vec<UnixStream> =
            (0..48).map(|n| connect_as(scratch, 20_000 + n / 16).expect("root may be anybody")).collect();
        let ours: Vec<UnixStream> = (0..16).map(|_| scratch.connect()).collect();
        for stream in others.iter().chain(&ours) {
            (&*stream).write_all(b"status\n").unwrap();
            assert!(matches!(reply(stream), Reply::Status { .. }), "all have their places");
        }
        let stranger = connect_as(scratch, 30_000).unwrap();
        (&stranger).write_all(b"status\n").unwrap();
        assert!(matches!(reply(&stranger), Reply::Status { .. }), "a newcomer takes the place of one of the others");
        let gone = others.iter().filter(|stream| {
            stream.set_nonblocking(true).unwrap();
            hung_up(stream)
        });
        assert_eq!(gone.count(), 1);
        for stream in &ours {
            (&*stream).write_all(b"status\n").unwrap();
            assert!(matches!(reply(stream), Reply::Status { .. }), "and none of ours");
        }
        assert!(said(&scratch.gimbald(&["status"])).contains("state "));
    });
}

fn connect_as_is_impossible(scratch: &Scratch) -> bool {
    let listener = std::os::unix::net::UnixListener::bind(scratch.socket()).unwrap();
    std::fs::set_permissions(scratch.socket(), std::os::unix::fs::PermissionsExt::from_mode(0o666)).unwrap();
    let is = connect_as(scratch, 20_000).is_none();
    drop(listener);
    std::fs::remove_file(scratch.socket()).unwrap();
    is
}

/// What one user asks without end is taken from no other user.
#[test]
fn users_have_their_own_shares() {
    let scratch = Scratch::new("users");
    if connect_as_is_impossible(&scratch) {
        return skipped("shares of several users: only root can connect as others");
    }
    let slow = Rate { per_second: 1e-3, burst: 5.0 };
    let limits = Limits { user: slow, others: Rate { burst: 8.0, ..slow }, ..unlimited() };
    served_with(scratch, 0o666, limits, Box::new(|| Ok(Settings::default())), |scratch, _| {
        let [alice, bob, root] = [20_001, 20_002, 0].map(|uid| connect_as(scratch, uid).unwrap());
        let answers = |mut stream: &UnixStream, count: usize| {
            stream.write_all(&b"status\n".repeat(20)).unwrap();
            (0..count).for_each(|_| assert!(matches!(reply(stream), Reply::Status { .. })));
            stream.set_read_timeout(Some(Duration::from_millis(200))).unwrap();
            assert!(stream.read(&mut [0; 8]).is_err_and(|error| error.kind() == ErrorKind::WouldBlock), "{count} and no more");
        };
        answers(&alice, 5);
        // eight for all users together, of which alice had five
        answers(&bob, 3);
        answers(&root, 5);
    });
}

/// One who connects again and again is refused at last, in words, and others of his user are not.
#[test]
fn who_connects_without_end_is_told_to_wait() {
    served("churn", Limits::default(), |scratch, _| {
        let over = Arc::new(AtomicBool::new(false));
        let (path, ends) = (scratch.socket(), over.clone());
        let (first_refusal, refused) = mpsc::channel();
        let churning = std::thread::spawn(move || {
            let mut count = 0;
            while !ends.load(Relaxed) {
                let stream = UnixStream::connect(&path).unwrap();
                stream.set_read_timeout(Some(LONG)).unwrap();
                let _ = (&stream).write(b"status\n");
                if matches!(reply(&stream), Reply::Refused(refusal) if refusal.kind == RefusalKind::Busy) {
                    count += 1;
                    let _ = first_refusal.send(());
                }
            }
            count
        });
        refused.recv_timeout(LONG).unwrap();
        for _ in 0..10 {
            assert!(said(&scratch.gimbald(&["status"])).contains("state "));
        }
        over.store(true, Relaxed);
        assert!(churning.join().unwrap() > 0);
    });
}

#[test]
fn slow_ones_are_hung_up_on() {
    let limits = Limits { slow: Duration::from_millis(300), idle: 10 * LONG, ..Limits::default() };
    served("slow", limits, |scratch, _| {
        // half a request, and now and then a byte more
        let mut loris = scratch.connect();
        let begun = Instant::now();
        while loris.write_all(b"x").is_ok() {
            assert!(begun.elapsed() < LONG);
            std::thread::sleep(Duration::from_millis(20));
        }
        // one who takes his answers byte by byte
        let mut sipping = scratch.connect();
        let begun = Instant::now();
        while sipping.write_all(&b"prometheus\n".repeat(100)).is_ok() {
            assert!(begun.elapsed() < LONG && sipping.read(&mut [0; 1]).is_ok_and(|read| read < 2));
            std::thread::sleep(Duration::from_millis(5));
        }
        // and one who is silent is not in anybody's way
        let quiet = scratch.connect();
        std::thread::sleep(Duration::from_millis(400));
        (&quiet).write_all(b"status\n").unwrap();
        assert!(matches!(reply(&quiet), Reply::Status { .. }));
    });
}

#[test]
fn patience_ends() {
    served("patience", Limits { idle: Duration::from_millis(50), ..Limits::default() }, |scratch, _| {
        assert!(hung_up(&scratch.connect()));
        // the typed client connects again, be it after a day
        let mut connection = Connection::open(&scratch.socket()).unwrap();
        std::thread::sleep(Duration::from_millis(200));
        assert_eq!(connection.status().unwrap().pid, std::process::id());
    });
}

/// A configuration that takes its time to be read (a network, a sleeping disk) keeps nobody waiting but who asked for it.
#[test]
fn a_slow_file_keeps_nobody_waiting() {
    let (go_on, may_go_on) = mpsc::channel::<()>();
    let may_go_on = Mutex::new(may_go_on);
    let read = move || {
        may_go_on.lock().unwrap().recv_timeout(LONG).map_err(|error| error.to_string())?;
        Ok(Settings::default())
    };
    let limits = Limits { reading: Duration::from_secs(1), ..Limits::default() };
    served_with(Scratch::new("reading"), 0o600, limits, Box::new(read), |scratch, _| {
        let waiting = scratch.connect();
        (&waiting).write_all(b"reload\nstatus\n").unwrap();
        assert!(said(&scratch.gimbald(&["status"])).contains("state "));
        let Reply::Refused(refusal) = reply(&waiting) else { panic!("it cannot have been read") };
        assert!(refusal.kind == RefusalKind::Late && refusal.error.contains("still being read"), "{refusal:?}");
        assert!(matches!(reply(&waiting), Reply::Status { .. }), "and the connection goes on");
        let late = scratch.gimbald(&["reload"]);
        assert_eq!(late.status.code(), Some(Exit::Unavailable.code().into()), "{late:?}");
        // both readings: the one that was given up, and the next
        (&waiting).write_all(b"reload\n").unwrap();
        go_on.send(()).unwrap();
        go_on.send(()).unwrap();
        assert!(matches!(reply(&waiting), Reply::Applied(_)));
    });
}
