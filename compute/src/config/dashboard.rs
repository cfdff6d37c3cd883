//! Options of the dashboard.

use serde::Deserialize;

/// Longest attribution (characters).
const ATTRIBUTION_MAX: usize = 200;

/// Options of the dashboard.
#[derive(Clone, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DashboardConfiguration {
    /// Address of the tiles below maps, with `{z}`, `{x}` and `{y}` in it, such as
    /// `https://tiles.example.org/{z}/{x}/{y}.png`. Browsers ask its host; without it they ask no
    /// host but this service.
    pub tiles: Option<String>,
    /// Whose tiles they are, as their host wants it shown on maps.
    pub attribution: String,
}

impl DashboardConfiguration {
    /// What is wrong; `None` if nothing is.
    pub(super) fn wrong(&self) -> Option<&'static str> {
        let Some(tiles) = &self.tiles else { return None };
        if self.tiles_origin().is_none() || !["{z}", "{x}", "{y}"].iter().all(|p| tiles.contains(p))
        {
            return Some(
                "dashboard.tiles must be such as https://tiles.example.org/{z}/{x}/{y}.png",
            );
        }
        let length = self.attribution.trim().chars().count();
        (length == 0 || ATTRIBUTION_MAX < length)
            .then_some("dashboard.tiles needs dashboard.attribution, at most 200 characters")
    }

    /// Scheme, host and port of the tiles, as a browser's policy names them.
    pub fn tiles_origin(&self) -> Option<String> {
        let (scheme, rest) = self.tiles.as_deref()?.split_once("://")?;
        let (host, path) = rest.split_once('/')?;
        let is_host = |c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '-' | ':');
        let is_path = |c: char| c.is_ascii_graphic() && !matches!(c, '"' | '\'' | '<' | '>');
        let is_sound = matches!(scheme, "http" | "https")
            && !host.is_empty()
            && host.chars().all(is_host)
            && path.chars().all(is_path);
        is_sound.then(|| format!("{scheme}://{host}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_template_names_one_host() {
        let wrong = |tiles: &str, attribution: &str| {
            let tiles = Some(tiles.to_owned());
            let attribution = attribution.to_owned();
            DashboardConfiguration { tiles, attribution }.wrong().is_some()
        };
        assert!(!wrong("https://a.example/{z}/{x}/{y}.png?key=1&b=2", "© A"));
        assert!(!wrong("http://127.0.0.1:81/{z}/{y}/{x}", "A"));
        for tiles in [
            "",
            "a.example/{z}/{x}/{y}",
            "ftp://a.example/{z}/{x}/{y}",
            "https:///{z}/{x}/{y}",
            "https://{s}.a.example/{z}/{x}/{y}",
            "https://a.example *; script-src x/{z}/{x}/{y}",
            "https://a.example/{z}/{x}",
            "https://a.example/{z}/{x}/{y}\"><script>",
        ] {
            assert!(wrong(tiles, "A"), "{tiles}");
        }
        assert!(wrong("https://a.example/{z}/{x}/{y}", " "));
        assert_eq!(DashboardConfiguration::default().wrong(), None);
    }
}
