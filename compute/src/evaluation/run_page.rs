//! One run as a self-contained HTML page: what was computed from what, counts, what limits the
//! positions, what they rest on, and figures.

use super::html::{END, escape, head, wide};

/// Begin of the lines that need attention.
const WARNING: &str = "warning: ";

/// The content of a page. All texts are plain.
#[derive(Clone, Debug, Default)]
pub struct RunPage {
    /// Title of the page.
    pub title: String,
    /// Names and values of what the run was.
    pub facts: Vec<(String, String)>,
    /// Number of epochs.
    pub epochs: u64,
    /// Number of epochs with each status.
    pub statuses: Vec<(String, u64)>,
    /// Number of epochs with each reason, and what the user can do about it.
    pub reasons: Vec<(String, u64, String)>,
    /// What the positions rest on; lines that need attention begin with "warning: ".
    pub provenance: Vec<String>,
    /// What was skipped of the files.
    pub skipped: Vec<String>,
}

impl RunPage {
    /// The page. `figures` are those of an [`Overview`](super::Overview), if they are kept.
    pub fn html(&self, figures: Option<&str>) -> String {
        let title = escape(&self.title);
        let mut page = head(&title, &title);
        let (warnings, others): (Vec<_>, Vec<_>) =
            self.provenance.iter().partition(|line| line.starts_with(WARNING));
        for line in warnings {
            let line = escape(line.trim_start_matches(WARNING));
            page += &format!("<p class=\"warn\"><strong>Warning:</strong> {line}</p>\n");
        }
        page += &self.facts();
        page += &self.statuses();
        page +=
            figures.unwrap_or("<h2>Figures</h2>\n<p>The figures of this run were not kept.</p>\n");
        page += &self.reasons();
        page += &list("What the positions rest on", &others, "The files of the rover alone.");
        let skipped: Vec<_> = self.skipped.iter().collect();
        page += &list("Skipped of the files", &skipped, "Nothing.");
        page + END
    }

    fn facts(&self) -> String {
        let row = |(name, value): &(String, String)| {
            format!("<tr><th scope=\"row\">{}</th><td>{}</td></tr>\n", escape(name), escape(value))
        };
        let rows: String = self.facts.iter().map(row).collect();
        format!("{}<table class=\"text\"><tbody>\n{rows}</tbody></table></div>\n", wide("The run"))
    }

    fn statuses(&self) -> String {
        let mut text = "<h2>Statuses</h2>\n<table><thead><tr><th scope=\"col\">Status</th>\
                        <th scope=\"col\">Epochs</th><th scope=\"col\">Part</th></tr></thead>\
                        <tbody>\n"
            .to_owned();
        let all = self.epochs.max(1) as f64;
        let mut statuses: Vec<_> = self.statuses.iter().collect();
        statuses.sort_by_key(|(_, epochs)| std::cmp::Reverse(*epochs));
        for (name, epochs) in statuses {
            text += &format!(
                "<tr><th scope=\"row\">{}</th><td>{epochs}</td><td>{:.1} %</td></tr>\n",
                escape(name),
                *epochs as f64 / all * 100.0
            );
        }
        text += &format!("<tr><th scope=\"row\">All</th><td>{}</td><td></td></tr>\n", self.epochs);
        text + "</tbody></table>\n"
    }

    fn reasons(&self) -> String {
        let heading = "<h2>What limits them</h2>\n";
        if self.reasons.is_empty() {
            return format!("{heading}<p>No epoch has a limiting reason.</p>\n");
        }
        let mut text = format!(
            "{heading}{}<table class=\"text\"><thead><tr>\
             <th scope=\"col\">Reason</th><th scope=\"col\">Epochs</th>\
             <th scope=\"col\">Remedy</th></tr></thead><tbody>\n",
            wide("Reasons")
        );
        let mut reasons: Vec<_> = self.reasons.iter().collect();
        reasons.sort_by_key(|(_, epochs, _)| std::cmp::Reverse(*epochs));
        for (code, epochs, remedy) in reasons {
            text += &format!(
                "<tr><th scope=\"row\"><code>{}</code></th><td class=\"number\">{epochs}</td>\
                 <td>{}</td></tr>\n",
                escape(code),
                escape(remedy)
            );
        }
        text + "</tbody></table></div>\n"
    }
}

fn list(title: &str, lines: &[&String], none: &str) -> String {
    let mut text = format!("<h2>{title}</h2>\n");
    if lines.is_empty() {
        return format!("{text}<p>{none}</p>\n");
    }
    text += "<ul>\n";
    lines.iter().for_each(|line| text += &format!("<li>{}</li>\n", escape(line)));
    text + "</ul>\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_has_all_of_a_run() {
        let owned = |text: &str| text.to_owned();
        let page = RunPage {
            title: owned("rover <1>"),
            facts: vec![(owned("Mode"), owned("rtk-fgo & more"))],
            epochs: 4,
            statuses: vec![(owned("FLOAT"), 1), (owned("FIXED"), 3)],
            reasons: vec![(owned("BASE_STALE"), 1, owned("look at <the> base"))],
            provenance: vec![owned("base: at home"), owned("warning: base: far off")],
            skipped: vec![owned("rover: line 7")],
        };
        let html = page.html(Some("<svg></svg>"));
        for part in [
            "<h1>rover &lt;1&gt;</h1>",
            "rtk-fgo &amp; more",
            "<th scope=\"row\">FIXED</th><td>3</td><td>75.0 %</td>",
            "<code>BASE_STALE</code></th><td class=\"number\">1</td><td>look at &lt;the&gt; base",
            "<strong>Warning:</strong> base: far off",
            "<li>base: at home</li>",
            "<li>rover: line 7</li>",
            "<svg></svg>",
        ] {
            assert!(html.contains(part), "{part} in {html}");
        }
        assert!(html.find("FIXED") < html.find("FLOAT"), "the most frequent first");
        assert!(page.html(None).contains("were not kept"));
        assert!(RunPage::default().html(None).contains("No epoch has a limiting reason"));
    }
}
