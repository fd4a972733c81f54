//! The page: shows a recording in any browser, or a server's stream. It loads nothing from other hosts.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;

const PAGE: &str = include_str!("page/page.html");
const STYLE: &str = include_str!("page/style.css");

/// The page's scripts, in this order, because each script uses the scripts before it. three.js is bundled by `make page-three`.
const SCRIPTS: [&str; 6] = [
    include_str!("page/three.js"),
    include_str!("page/recording.js"),
    include_str!("page/sand.js"),
    include_str!("page/world.js"),
    include_str!("page/charts.js"),
    include_str!("page/main.js"),
];

/// A page that shows the recording `file`, the bytes of a file that [`super::read`] has accepted.
pub fn replay(file: &[u8], title: &str) -> String {
    let data = STANDARD.encode(file);
    filled(title, &format!("<script type=\"text/plain\" id=\"recording\">{data}</script>"))
}

/// The page of a server. It requests `sessions` and `watch` relative to its own address.
pub fn live(title: &str) -> String {
    filled(title, "")
}

fn filled(title: &str, data: &str) -> String {
    let scripts = SCRIPTS.map(|s| format!("<script>\n{s}\n</script>\n")).concat();
    let title = crate::plot::escape(title);
    let page = PAGE.replace("{{title}}", &title).replace("{{style}}", STYLE);
    // The scripts are inserted last, so that marks inside them are not replaced.
    page.replace("{{data}}", data).replace("{{scripts}}", &scripts)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The page contains everything: no script names a host, and no script contains its own end tag.
    #[test]
    fn the_page_is_whole() {
        let page = replay(b"file", "a <title>");
        assert!(page.contains("a &lt;title&gt;") && page.contains(&STANDARD.encode(b"file")) && !page.contains("{{"));
        assert_eq!(page.matches("<script").count(), page.matches("</script>").count());
        assert_eq!(page.matches("<script").count(), SCRIPTS.len() + 1);
        assert_eq!(live("x").matches("<script").count(), SCRIPTS.len());
        for scheme in ["http://", "https://", "ws://", "wss://", "url(", "@import", "import("] {
            for (at, _) in page.match_indices(scheme) {
                // The name of an XML name space, which is not fetched.
                assert!(page[at..].starts_with("http://www.w3.org/1999/xhtml"), "{}", &page[at..at + 60]);
            }
        }
    }
}
