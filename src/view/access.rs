//! Which requests are answered, by their headers.

use std::fs::File;
use std::io::{self, Read};

/// What the decision depends on.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct RequestInfo<'a> {
    /// Path and query, as sent.
    pub(super) target: &'a str,
    /// Whether it may change something.
    pub(super) is_post: bool,
    pub(super) host: Option<&'a str>,
    pub(super) origin: Option<&'a str>,
    pub(super) fetch_site: Option<&'a str>,
}

/// The rule of this server.
#[derive(Clone, Debug)]
pub(super) struct Access {
    token: String,
    port: u16,
}

impl Access {
    /// A new token for the server at `port`.
    ///
    /// # Errors
    /// Where the system gives no random numbers.
    pub(super) fn new(port: u16) -> io::Result<Self> {
        let mut bytes = [0; 16];
        File::open("/dev/urandom")?.read_exact(&mut bytes)?;
        let token = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
        Ok(Self { token, port })
    }

    /// The secret part of the address.
    pub(super) fn token(&self) -> &str {
        &self.token
    }

    /// The address of the page.
    pub(super) fn address(&self) -> String {
        format!("http://127.0.0.1:{}/{}/", self.port, self.token)
    }

    /// The path below the token if the request is to be answered; otherwise the status to refuse it with.
    pub(super) fn check<'a>(&self, request: &RequestInfo<'a>) -> Result<&'a str, u16> {
        let names = [format!("127.0.0.1:{}", self.port), format!("localhost:{}", self.port)];
        if !request.host.is_some_and(|host| names.iter().any(|name| name == host)) {
            return Err(403);
        }
        let own = |origin: &str| names.iter().any(|name| origin.strip_prefix("http://") == Some(name));
        let rest = request.target.strip_prefix('/').and_then(|rest| rest.split_once('/'));
        let Some((_, what)) = rest.filter(|(token, _)| same(token, &self.token)) else { return Err(404) };
        // The page may be opened by a link from anywhere; everything else is requested by the page itself.
        let is_page = what.is_empty() && !request.is_post;
        let foreign = request.origin.is_some_and(|origin| !own(origin))
            || (request.is_post && request.origin.is_none())
            || (!is_page && request.fetch_site.is_some_and(|site| site != "same-origin"));
        if foreign && !(is_page && request.origin.is_none()) { Err(403) } else { Ok(what) }
    }
}

/// Compares in a time that does not depend on where the two differ.
fn same(one: &str, other: &str) -> bool {
    one.len() == other.len() && one.bytes().zip(other.bytes()).fold(0, |differs, (a, b)| differs | (a ^ b)) == 0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_page_itself_and_programs_with_its_address_are_answered() {
        let access = Access::new(8000).unwrap();
        let address = access.address();
        let path = address.strip_prefix("http://127.0.0.1:8000").unwrap();
        let target = |what: &str| format!("{path}{what}");
        let (page, state, set) = (target(""), target("state"), target("set"));
        let host = Some("127.0.0.1:8000");
        let plain = RequestInfo { target: &page, host, ..RequestInfo::default() };
        let asked = RequestInfo { target: &state, host, fetch_site: Some("same-origin"), ..plain };
        let post = RequestInfo { target: &set, is_post: true, origin: Some("http://127.0.0.1:8000"), ..asked };
        assert_eq!(access.check(&plain), Ok(""));
        assert_eq!(access.check(&RequestInfo { fetch_site: Some("cross-site"), ..plain }), Ok(""), "a link in a file");
        assert_eq!((access.check(&asked), access.check(&post)), (Ok("state"), Ok("set")));
        assert_eq!(access.check(&RequestInfo { fetch_site: None, ..asked }), Ok("state"), "a program that is not a browser");
        assert_eq!(
            access.check(&RequestInfo { host: Some("localhost:8000"), origin: Some("http://localhost:8000"), ..post }),
            Ok("set")
        );
        for (what, refused, status) in [
            ("another name", RequestInfo { host: Some("evil.example:8000"), ..asked }, 403),
            ("another port", RequestInfo { host: Some("127.0.0.1:80"), ..asked }, 403),
            ("no name", RequestInfo { host: None, ..asked }, 403),
            ("another site's script", RequestInfo { origin: Some("https://evil.example"), ..asked }, 403),
            ("a page that is a file", RequestInfo { origin: Some("null"), ..post }, 403),
            ("another port's page", RequestInfo { origin: Some("http://127.0.0.1:8001"), ..post }, 403),
            ("another site's image", RequestInfo { fetch_site: Some("cross-site"), ..asked }, 403),
            ("another port's image", RequestInfo { fetch_site: Some("same-site"), ..asked }, 403),
            ("a change without an origin", RequestInfo { origin: None, ..post }, 403),
            ("another site's script that reads the page", RequestInfo { origin: Some("https://evil.example"), ..plain }, 403),
            ("no token", RequestInfo { target: "/state", ..asked }, 404),
            ("another token", RequestInfo { target: "/00000000000000000000000000000000/state", ..asked }, 404),
            ("half a token", RequestInfo { target: &state[9..], ..asked }, 404),
            ("nothing", RequestInfo { target: "", ..asked }, 404),
        ] {
            assert_eq!(access.check(&refused), Err(status), "{what}");
        }
        assert_ne!(Access::new(8000).unwrap().token, access.token);
    }
}
