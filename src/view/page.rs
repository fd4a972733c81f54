//! The page: a recording that plays by itself in any browser, or what a server streams. Nothing is fetched from elsewhere.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;

const PAGE: &str = include_str!("page/page.html");
const STYLE: &str = include_str!("page/style.css");

/// In this order: each uses those before it. three.js is bundled by `make page-three`.
const SCRIPTS: [&str; 5] = [
    include_str!("page/three.js"),
    include_str!("page/recording.js"),
    include_str!("page/world.js"),
    include_str!("page/charts.js"),
    include_str!("page/main.js"),
];

/// A page that shows the recording `file`, the bytes of a file that [`super::read`] took.
pub fn replay(file: &[u8], title: &str) -> String {
    let data = STANDARD.encode(file);
    filled(title, &format!("<script type=\"text/plain\" id=\"recording\">{data}</script>"))
}

/// The page that a server shows of itself: it asks for `sessions` and `watch` beside it.
pub fn live(title: &str) -> String {
    filled(title, "")
}

fn filled(title: &str, data: &str) -> String {
    let scripts = SCRIPTS.map(|s| format!("<script>\n{s}\n</script>\n")).concat();
    let title = crate::plot::escape(title);
    let page = PAGE.replace("{{title}}", &title).replace("{{style}}", STYLE);
    // The scripts last: what they hold is none of our marks.
    page.replace("{{data}}", data).replace("{{scripts}}", &scripts)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Everything is inside: no page may name a host, and no script may end before its end.
    #[test]
    fn the_page_is_whole() {
        let page = replay(b"file", "a <title>");
        assert!(page.contains("a &lt;title&gt;") && page.contains(&STANDARD.encode(b"file")) && !page.contains("{{"));
        assert_eq!(page.matches("<script").count(), page.matches("</script>").count());
        assert_eq!(page.matches("<script").count(), SCRIPTS.len() + 1);
        assert_eq!(live("x").matches("<script").count(), SCRIPTS.len());
        for scheme in ["http://", "https://", "ws://", "wss://", "url(", "@import", "import("] {
            for (at, _) in page.match_indices(scheme) {
                // A name of XML, which is no address.
                assert!(page[at..].starts_with("http://www.w3.org/1999/xhtml"), "{}", &page[at..at + 60]);
            }
        }
    }
}
