//! Quotas of users, processes and all clients together, and which connection is closed in favour of a new one.

use std::cmp::Reverse;
use std::collections::HashMap;
use std::time::{Duration, Instant};

use super::session::{At, Peer, Session};
use super::token_bucket::{Rate, TokenBucket};

/// How many may be connected, how much each may ask, and how long each may take.
///
/// Requests are limited at four levels: a connection, a process, a user, and all users but root and the daemon's own together. A
/// process is told by its number, so that one that asks without end does not use up what others of its user have. That matters most
/// where users cannot be told apart: in a user namespace, as systemd's `PrivateUsers=` makes one, all but root and the daemon's own appear
/// as one.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// Connections at a time.
    pub places: usize,
    /// Of these, for root and the daemon's own user alone.
    pub kept: usize,
    /// Of these, for one user at most.
    pub per_user: usize,
    /// Of these, for one process at most.
    pub per_process: usize,
    /// Requests of one connection.
    pub connection: Rate,
    /// Requests and connections of one process.
    pub process: Rate,
    /// Requests of one user.
    pub user: Rate,
    /// Requests of all users but root and the daemon's own.
    pub others: Rate,
    /// Connections accepted, be it to refuse them.
    pub accepted: Rate,
    /// How long a connection may ask nothing.
    pub idle: Duration,
    /// How long one request may take to arrive, and one reply to be taken.
    pub slow: Duration,
    /// How long a client waits for the configuration to be read.
    pub reading: Duration,
}

impl Default for Limits {
    fn default() -> Self {
        let rate = |per_second, burst| Rate { per_second, burst };
        Self {
            places: 64,
            kept: 16,
            per_user: 32,
            per_process: 16,
            connection: rate(20.0, 40.0),
            process: rate(50.0, 100.0),
            user: rate(100.0, 200.0),
            others: rate(200.0, 400.0),
            accepted: rate(1000.0, 64.0),
            idle: Duration::from_secs(60),
            slow: Duration::from_secs(10),
            // Less than a client waits.
            reading: Duration::from_secs(4),
        }
    }
}

/// What each has used of it.
#[derive(Debug)]
pub(super) struct Quotas {
    limits: Limits,
    processes: HashMap<Peer, TokenBucket>,
    users: HashMap<u32, TokenBucket>,
    others: TokenBucket,
    tidied: Instant,
}

impl Quotas {
    /// Nothing was used.
    pub(super) fn new(limits: &Limits, now: Instant) -> Self {
        Self {
            limits: *limits,
            processes: HashMap::new(),
            users: HashMap::new(),
            others: TokenBucket::new(limits.others, now),
            tidied: now,
        }
    }

    /// Whether a process may have one more connection now; where it may, that is charged.
    pub(super) fn connect(&mut self, peer: Peer, now: Instant) -> bool {
        self.tidy(now);
        let process = self.processes.entry(peer).or_insert_with(|| TokenBucket::new(self.limits.process, now));
        process.try_take(now)
    }

    /// How long it takes until the session's next request may be answered.
    pub(super) fn wait(&self, session: &Session, now: Instant) -> Duration {
        let process = self.processes.get(&session.peer).map_or(Duration::ZERO, |process| process.wait(now));
        let user = self.users.get(&session.peer.uid).map_or(Duration::ZERO, |user| user.wait(now));
        let others = if session.trusted { Duration::ZERO } else { self.others.wait(now) };
        session.bucket.wait(now).max(process).max(user).max(others)
    }

    /// Charges one request of the session.
    pub(super) fn charge(&mut self, session: &mut Session, now: Instant) {
        session.bucket.take(now);
        let process = self.processes.entry(session.peer).or_insert_with(|| TokenBucket::new(self.limits.process, now));
        process.take(now);
        self.users.entry(session.peer.uid).or_insert_with(|| TokenBucket::new(self.limits.user, now)).take(now);
        if !session.trusted {
            self.others.take(now);
        }
    }

    /// The sessions with a request, in the order in which they are to be served: whose process has asked least of late comes first,
    /// then whose connection has, then who has waited longest.
    pub(super) fn order(&self, sessions: &[Session], now: Instant) -> Vec<usize> {
        let taken = |index: usize| {
            let session = &sessions[index];
            let process = self.processes.get(&session.peer).map_or(0.0, |process| process.taken(now));
            (process, session.bucket.taken(now))
        };
        let mut order: Vec<usize> = (0..sessions.len()).filter(|&index| sessions[index].at() == At::Ready).collect();
        order.sort_by(|&a, &b| {
            let (one, other) = (taken(a), taken(b));
            one.0.total_cmp(&other.0).then(one.1.total_cmp(&other.1)).then(sessions[a].since().cmp(&sessions[b].since()))
        });
        order
    }

    /// Which session has to go so that `newcomer` has a place; `None` where there is one free.
    pub(super) fn displaced(&self, sessions: &[Session], newcomer: Peer, now: Instant) -> Option<usize> {
        let trusted = newcomer.is_trusted();
        let count = |of: &dyn Fn(&Session) -> bool| sessions.iter().filter(|session| of(session)).count();
        let of_process = |session: &Session| session.peer == newcomer;
        let of_user = |session: &Session| session.peer.uid == newcomer.uid;
        let of_others = |session: &Session| !session.trusted;
        let all = |_: &Session| true;
        let from: &dyn Fn(&Session) -> bool = if count(&of_process) >= self.limits.per_process {
            &of_process
        } else if count(&of_user) >= self.limits.per_user {
            &of_user
        } else if !trusted && count(&of_others) + self.limits.kept >= self.limits.places {
            &of_others
        } else if sessions.len() >= self.limits.places {
            &all
        } else {
            return None;
        };
        // Of the user and the process with most connections: first one that asks too much, then the one that has rested longest.
        let rank = |session: &Session| {
            let user = count(&|other| other.peer.uid == session.peer.uid);
            let process = count(&|other| other.peer == session.peer);
            let awaited = session.at() == At::Reloading;
            (Reverse(user), Reverse(process), awaited, session.bucket.has(now), session.since())
        };
        (0..sessions.len()).filter(|&index| from(&sessions[index])).min_by_key(|&index| rank(&sessions[index]))
    }

    /// Forgets those whose quotas are full again.
    fn tidy(&mut self, now: Instant) {
        if now.saturating_duration_since(self.tidied) >= Duration::from_secs(1) {
            self.tidied = now;
            self.processes.retain(|_, bucket| !bucket.is_new(now));
            self.users.retain(|_, bucket| !bucket.is_new(now));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;
    use std::os::unix::net::UnixStream;

    const LIMITS: fn() -> Limits = Limits::default;

    /// Sessions of these peers, in the order in which they connected, and the clients' ends.
    fn sessions(peers: &[(u32, i32)], start: Instant) -> (Vec<UnixStream>, Vec<Session>) {
        let made = peers.iter().enumerate().map(|(index, &(uid, pid))| {
            let (client, stream) = UnixStream::pair().unwrap();
            let now = start + Duration::from_millis(index as u64);
            (client, Session::new(stream, Peer { uid, pid }, &LIMITS(), now).unwrap())
        });
        made.unzip()
    }

    /// A user that is neither root nor our own.
    fn stranger(n: u32) -> u32 {
        rustix::process::geteuid().as_raw() + 1000 + n
    }

    #[test]
    fn places_are_kept_for_root_and_the_own_user() {
        let now = Instant::now();
        let quotas = Quotas::new(&LIMITS(), now);
        let (alice, bob, carol) = (stranger(1), stranger(2), stranger(3));
        // alice has 20, bob 28: all that others may have
        let peers: Vec<(u32, i32)> = (0..48).map(|n| if n < 20 { (alice, n) } else { (bob, n) }).collect();
        let (_clients, mut all) = sessions(&peers, now);
        assert_eq!(quotas.displaced(&all, Peer { uid: 0, pid: 1 }, now), None, "root has a place");
        assert_eq!(quotas.displaced(&all, Peer { uid: carol, pid: 1 }, now), Some(20), "of bob, who has most");
        let more: Vec<(u32, i32)> = (0..15).map(|n| (0, 100 + n)).collect();
        let (_more, others) = sessions(&more, now);
        all.extend(others);
        assert_eq!(quotas.displaced(&all, Peer { uid: 0, pid: 1 }, now), None);
        let (_last, others) = sessions(&[(0, 200)], now);
        all.extend(others);
        assert_eq!(all.len(), LIMITS().places);
        assert_eq!(quotas.displaced(&all, Peer { uid: 0, pid: 1 }, now), Some(20), "and then again bob gives one up");
    }

    #[test]
    fn nobody_has_all_places_and_a_process_displaces_its_own() {
        let now = Instant::now();
        let quotas = Quotas::new(&LIMITS(), now);
        let peers: Vec<(u32, i32)> = (0..17).map(|n| (0, if n == 3 { 2 } else { 1 })).collect();
        let (_clients, mut all) = sessions(&peers, now);
        assert_eq!(quotas.displaced(&all, Peer { uid: 0, pid: 1 }, now), Some(0), "the one that has rested longest");
        assert_eq!(quotas.displaced(&all, Peer { uid: 0, pid: 2 }, now), None);
        // one that asks too much goes before
        (0..40).for_each(|_| all[7].bucket.take(now));
        assert_eq!(quotas.displaced(&all, Peer { uid: 0, pid: 1 }, now), Some(7));
        let peers: Vec<(u32, i32)> = (0..32).map(|n| (5, if n < 12 { 1 } else { n })).collect();
        let (_clients, all) = sessions(&peers, now);
        assert_eq!(quotas.displaced(&all, Peer { uid: 5, pid: 99 }, now), Some(0), "of the process that has most");
    }

    #[test]
    fn who_has_asked_least_goes_first() {
        let now = Instant::now();
        let mut quotas = Quotas::new(&LIMITS(), now);
        let (clients, mut all) = sessions(&[(0, 1), (0, 1), (0, 2), (0, 3)], now);
        for (client, session) in clients.iter().zip(&mut all).take(3) {
            (&*client).write_all(b"status\n").unwrap();
            assert!(session.talk(now));
        }
        assert_eq!(quotas.order(&all, now), [0, 1, 2], "who was first, and not who asks nothing");
        quotas.charge(&mut all[0], now);
        assert_eq!(quotas.order(&all, now), [2, 1, 0]);
    }

    /// Many processes of one user that each ask no more than they may, and together more than the user may: another one comes first.
    #[test]
    fn a_newcomer_goes_before_those_who_have_asked() {
        let mut now = Instant::now();
        let mut quotas = Quotas::new(&LIMITS(), now);
        let peers: Vec<(u32, i32)> = (0..17).map(|n| (0, n)).collect();
        let (clients, mut all) = sessions(&peers, now);
        for (client, session) in clients.iter().zip(&mut all) {
            (&*client).write_all(b"status\n").unwrap();
            assert!(session.talk(now));
        }
        for _ in 0..5 {
            now += Duration::from_secs(1);
            (0..16).for_each(|index| quotas.charge(&mut all[index], now));
        }
        now += Duration::from_secs(2);
        assert!(quotas.connect(Peer { uid: 0, pid: 16 }, now));
        assert_eq!(quotas.order(&all, now)[0], 16);
    }

    #[test]
    fn a_process_that_asks_without_end_leaves_others_of_its_user_their_share() {
        let now = Instant::now();
        let mut quotas = Quotas::new(&LIMITS(), now);
        let peers: Vec<(u32, i32)> = (0..17).map(|n| (stranger(1), if n == 16 { 2 } else { 1 })).collect();
        let (_clients, mut all) = sessions(&peers, now);
        let mut served = 0;
        for round in 0..10_000 {
            for session in &mut all[..16] {
                if quotas.wait(session, now).is_zero() {
                    quotas.charge(session, now);
                    served += 1;
                }
            }
            assert!(round < 1000 || served == 100, "{served}: the process's burst");
        }
        assert!(quotas.wait(&all[16], now).is_zero());
        assert!(quotas.wait(&all[0], now) > Duration::ZERO);
        assert!(
            !quotas.connect(Peer { uid: stranger(1), pid: 1 }, now) && quotas.connect(Peer { uid: stranger(1), pid: 2 }, now)
        );
    }

    #[test]
    fn who_is_gone_is_forgotten() {
        let mut now = Instant::now();
        let mut quotas = Quotas::new(&LIMITS(), now);
        for pid in 0..10_000 {
            now += Duration::from_millis(1);
            assert!(quotas.connect(Peer { uid: 0, pid }, now));
        }
        // a second or two more than it takes to count less than a half
        assert!(quotas.processes.len() < 7500, "{}", quotas.processes.len());
        now += Duration::from_secs(60);
        assert!(quotas.connect(Peer { uid: 0, pid: 1 }, now) && quotas.processes.len() == 1);
    }
}
