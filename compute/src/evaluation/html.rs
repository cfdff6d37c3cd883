//! What the self-contained HTML pages have in common: they need no script and no other file, and
//! follow the reader's choice of light or dark.

use super::plot::PlotError;

/// The style sheet of all pages. The colours of figures are attributes of their elements, so the
/// dark ones replace them by their values.
pub(crate) const STYLE: &str = "\
:root{color-scheme:light dark;--ink:#222;--muted:#606060;--paper:#fff;--soft:#f2f2f2;--line:#ddd;\
--warn:#8a3b00}\
body{font:16px/1.5 system-ui,sans-serif;color:var(--ink);background:var(--paper);\
max-width:1160px;margin:2rem auto;padding:0 1rem}\
h1{font-size:1.6rem;margin-bottom:.2rem;overflow-wrap:anywhere}\
h2{font-size:1.2rem;margin-top:2.2rem}\
p{max-width:48rem}.muted{color:var(--muted)}.warn{color:var(--warn)}\
code{background:var(--soft);padding:.1rem .3rem;overflow-wrap:anywhere}\
table{border-collapse:collapse;margin:.8rem 0}\
th,td{padding:.3rem .8rem;border-bottom:1px solid var(--line);text-align:right;\
font-variant-numeric:tabular-nums}\
th:first-child,td:first-child{text-align:left}th[scope=row]{font-weight:inherit}\
thead th{border-bottom:2px solid var(--ink);vertical-align:bottom}\
.text td,.text th{text-align:left;vertical-align:top}.text td{overflow-wrap:anywhere}\
.text th code{overflow-wrap:normal}.text td.number{text-align:right}li{overflow-wrap:anywhere}\
.swatch{width:.8em;height:.8em;margin-right:.35em}\
.legend span{display:inline-block;margin-right:1.4rem}figure{margin:1rem 0;overflow-x:auto}\
figure>svg{max-width:100%;height:auto}figcaption{color:var(--muted)}.wide{overflow-x:auto}\
@media(prefers-color-scheme:dark){:root{--ink:#e8e8e8;--muted:#a8a8a8;--paper:#14181c;\
--soft:#262c32;--line:#3a4148;--warn:#ffb27a}\
[fill=\"#222222\"]{fill:#e8e8e8}[stroke=\"#222222\"]{stroke:#e8e8e8}\
[fill=\"#000000\"]{fill:#f5f5f5}[stroke=\"#000000\"]{stroke:#f5f5f5}\
[fill=\"#5A5A5A\"]{fill:#c0c0c0}[stroke=\"#5A5A5A\"]{stroke:#c0c0c0}\
[fill=\"#606060\"]{fill:#a8a8a8}[stroke=\"#606060\"]{stroke:#8a8a8a}\
[stroke=\"#E1E1E1\"]{stroke:#353c43}\
[fill=\"#0072B2\"]{fill:#4aa8e0}[stroke=\"#0072B2\"]{stroke:#4aa8e0}\
[fill=\"#00785A\"]{fill:#2bc79b}[fill=\"#A86400\"]{fill:#f0b429}\
[fill=\"#0B76B8\"]{fill:#6cc4f5}[fill=\"#4450C8\"]{fill:#9aa7ff}\
[fill=\"#A8327C\"]{fill:#e08fc0}[fill=\"#C23A00\"]{fill:#ff7a45}}\
@media print{body{margin:0}section{break-inside:avoid}}";

/// The begin of a page, up to its heading. `title` is escaped.
pub(crate) fn head(title: &str, heading: &str) -> String {
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\
         <meta name=\"viewport\" content=\"width=device-width\">\
         <title>{title}</title><style>{STYLE}</style></head><body><main>\n<h1>{heading}</h1>\n"
    )
}

/// The end of a page.
pub(crate) const END: &str = "</main></body></html>\n";

/// The opening tag of what may be wider than the page, and scrolls then; by the keyboard, too.
/// `name` is HTML.
pub(crate) fn wide(name: &str) -> String {
    format!("<div class=\"wide\" role=\"region\" aria-label=\"{name}\" tabindex=\"0\">")
}

/// A figure with its legend, or a note if it has no data. `text` describes it to those who do not
/// see it. Legend and texts are HTML.
///
/// # Errors
/// The drawing has failed.
pub(crate) fn figure(
    (title, text): (&str, &str),
    legend: &str,
    drawing: Result<String, PlotError>,
) -> Result<String, PlotError> {
    let svg = match drawing {
        Ok(svg) => described(&svg, title, text),
        Err(PlotError::Empty) => "<p class=\"muted\">Nothing to show.</p>".to_owned(),
        Err(error) => return Err(error),
    };
    Ok(format!(
        "<section><h2>{title}</h2>\n<figure><figcaption class=\"legend\">{legend}</figcaption>\n\
         {svg}\n</figure></section>\n"
    ))
}

/// An SVG with a title and a description, by which screen readers tell it.
fn described(svg: &str, title: &str, text: &str) -> String {
    let id: String = title.chars().filter(char::is_ascii_alphanumeric).collect();
    let Some((opening, content)) = svg.split_once('>') else { return svg.to_owned() };
    format!(
        "{opening} role=\"img\" aria-labelledby=\"{id}-title {id}-text\">\
         <title id=\"{id}-title\">{title}</title><desc id=\"{id}-text\">{text}</desc>{content}"
    )
}

/// A dot in a colour.
pub(crate) fn swatch(color: &str) -> String {
    format!(
        "<svg class=\"swatch\" viewBox=\"0 0 10 10\" aria-hidden=\"true\">\
         <circle cx=\"5\" cy=\"5\" r=\"5\" fill=\"{color}\"/></svg>"
    )
}

/// Escapes text for HTML.
pub(crate) fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_figure_is_told_by_its_title_and_text() {
        let svg = Ok("<svg width=\"9\"><line/></svg>".to_owned());
        let told = figure(("Height over time", "flat"), "", svg).unwrap();
        let expected = "<svg width=\"9\" role=\"img\" \
                        aria-labelledby=\"Heightovertime-title Heightovertime-text\">\
                        <title id=\"Heightovertime-title\">Height over time</title>\
                        <desc id=\"Heightovertime-text\">flat</desc><line/></svg>";
        assert!(told.contains(expected), "{told}");
        let nothing = figure(("Height", ""), "", Err(PlotError::Empty)).unwrap();
        assert!(nothing.contains("Nothing to show"));
    }
}
