//! Why no link to an endpoint opens.

use std::io;
use std::net::{TcpStream, ToSocketAddrs as _};
use std::time::Duration;

/// How long to wait for a connection.
const PATIENCE: Duration = Duration::from_millis(500);

/// What the system says of each endpoint at which no program accepts connections. Endpoints without TCP are left out.
pub(crate) fn unreached(endpoints: &[String]) -> Vec<String> {
    let said = |endpoint: &String| {
        let address = address(endpoint)?;
        let error = connect(address).err()?;
        Some(format!("{endpoint}: {}", text(&error)))
    };
    endpoints.iter().filter_map(said).collect()
}

/// `HOST:PORT` of an endpoint such as `tls/HOST:PORT?option#setting`.
fn address(endpoint: &str) -> Option<&str> {
    let rest = (endpoint.strip_prefix("tcp/")).or_else(|| endpoint.strip_prefix("tls/"))?;
    rest.split(['?', '#']).next()
}

fn connect(address: &str) -> io::Result<()> {
    let mut last = io::Error::other("the host has no address");
    for address in address.to_socket_addrs()? {
        match TcpStream::connect_timeout(&address, PATIENCE) {
            Ok(_) => return Ok(()),
            Err(error) => last = error,
        }
    }
    Err(last)
}

/// The text of an error without the number that Rust puts behind it.
fn text(error: &io::Error) -> String {
    let text = error.to_string();
    let text = text.split(" (os error").next().unwrap_or(&text);
    let text = text.trim_start_matches("failed to lookup address information: ");
    text.to_owned()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::net::TcpListener;

    use super::*;

    #[test]
    fn an_endpoint_at_which_nobody_listens_is_told() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let open = format!("tcp/{}", listener.local_addr().unwrap());
        let closed = {
            let other = TcpListener::bind("127.0.0.1:0").unwrap();
            format!("tls/{}?iface=lo", other.local_addr().unwrap())
        };
        let found = unreached(&[open, closed.clone(), "unixpipe/x".to_owned()]);
        assert_eq!(found, [format!("{closed}: Connection refused")]);
        let found = unreached(&["tcp/127.0.0.1".to_owned()]);
        assert_eq!(found, ["tcp/127.0.0.1: invalid socket address"]);
    }
}
