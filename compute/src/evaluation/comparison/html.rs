//! The report as one self-contained HTML page.

use std::fmt::Write as _;

use super::{Comparison, Method, figures};
use crate::evaluation::MatchedReport;
use crate::evaluation::html::{END, escape, figure, head, swatch, wide};
use crate::evaluation::plot::PlotError;
use crate::evaluation::plot::series::{css_color, css_quality};
use crate::gnss::Status;

/// The whole page.
pub(super) fn page(comparison: &Comparison) -> Result<String, PlotError> {
    let title = escape(&comparison.title);
    let mut page = head(&format!("{title}: comparison"), &title);
    page += &format!("<p class=\"muted\">{}</p>\n", escape(&span(comparison)));
    let is_judged = !comparison.judgements.is_empty();
    if is_judged {
        page += &table("Positioning error", &error_rows(comparison), comparison);
    } else {
        page += "<p>No truth was given: the report shows how far the methods agree.</p>\n";
    }
    if comparison.is_relative() {
        page += &table("Integers", &integer_rows(comparison), comparison);
    }
    let lines = legend(comparison);
    let track = if is_judged { "Tracks over the truth (black)" } else { "Tracks" };
    let each = |what: &str| format!("{what} of each method; the tables have the figures");
    page +=
        &figure((track, &each("Positions, east and north,")), &lines, figures::tracks(comparison))?;
    let error = if is_judged { "Horizontal error over time" } else { "Distance over time" };
    page += &figure((error, &each("Lines")), &lines, figures::errors(comparison))?;
    if comparison.is_relative() {
        let (statuses, legend) = (figures::statuses(comparison), status_legend());
        page += &figure(("Status over time", &each("A coloured strip")), &legend, statuses)?;
        let ratios = figures::ratios(comparison);
        page += &figure(("Ratio of the integers over time", &each("Lines")), &lines, ratios)?;
    }
    let satellites = figures::satellites(comparison);
    page += &figure(("Satellites over time", &each("Lines")), &lines, satellites)?;
    page += &agreement(comparison);
    page += &table("Reasons: number of epochs with each", &reason_rows(comparison), comparison);
    page += &configuration(comparison);
    page += END;
    Ok(page)
}

fn span(comparison: &Comparison) -> String {
    let epochs = comparison.methods.iter().map(|method| method.solutions.len()).max().unwrap_or(0);
    let times = || comparison.methods.iter().flat_map(|m| &m.solutions).map(|s| s.time);
    let tow = |time: Option<crate::gnss::GpsTime>| time.map_or(0.0, |t| t.seconds_of_week());
    let (first, last) = (times().min(), times().max());
    format!(
        "{epochs} epochs, GPS week {}, seconds {:.3} to {:.3}",
        first.map_or(0, |time| time.week()),
        tow(first),
        tow(last)
    )
}

/// A row of a table: its name and one cell for each method.
type Row = (String, Vec<String>);

fn row(name: &str, cells: impl IntoIterator<Item = String>) -> Row {
    (name.to_owned(), cells.into_iter().collect())
}

/// Table 1 of Wen & Hsu (2021), followed by further figures.
fn error_rows(comparison: &Comparison) -> Vec<Row> {
    let judgements = &comparison.judgements;
    let number = |value: fn(&MatchedReport) -> f64| {
        judgements.iter().map(move |j| meters(j.report.errors.as_ref().map(value)))
    };
    let stated = |value: fn(&crate::evaluation::Uncertainty) -> f64, percent: bool| {
        judgements.iter().map(move |judgement| {
            let stated = judgement.report.errors.as_ref().and_then(|e| e.uncertainty.as_ref());
            match stated.map(value) {
                Some(share) if percent => format!("{:.1} %", 100.0 * share),
                other => plain(other, 2),
            }
        })
    };
    vec![
        row("MEAN 2D (m)", number(|e| e.err2d.mean)),
        row("STD 2D (m)", number(|e| e.err2d.std)),
        row("MAX 2D (m)", number(|e| e.err2d.max)),
        row("Availability", judgements.iter().map(|j| percent(j.report.availability))),
        row("Median 2D (m)", number(|e| e.err2d.p50)),
        row("95 % 2D (m)", number(|e| e.err2d.p95)),
        row("Mean 3D (m)", number(|e| e.err3d.mean)),
        row("Mean height error (m)", number(|e| e.bias_enu_mean[2])),
        row("Inside the stated 95 % ellipse", stated(|u| u.inside_95_2d, true)),
        row("Normalised error 2D (consistent: 1)", stated(|u| u.normalised_rms_2d, false)),
        row("Epochs per second", comparison.methods.iter().map(speed)),
    ]
}

/// The fixed rate, as in table 2 of the paper, and the correctness of the fixes.
fn integer_rows(comparison: &Comparison) -> Vec<Row> {
    let methods = &comparison.methods;
    let share = |status| methods.iter().map(move |method| percent(Some(method.share_with(status))));
    let mut rows = vec![
        row("Fixed rate", share(Status::Fixed)),
        row("Float", share(Status::Float)),
        row("Without base", share(Status::Fgo)),
        row("No position", share(Status::None)),
    ];
    let fixes = |cell: fn(&crate::evaluation::FixedErrors) -> String| {
        comparison.judgements.iter().map(move |judgement| {
            let fixes = judgement.report.errors.as_ref().and_then(|e| e.fix.errors.as_ref());
            fixes.map_or_else(|| "–".to_owned(), cell)
        })
    };
    if !comparison.judgements.is_empty() {
        rows.push(row("Wrong fixes (2D beyond the limit)", fixes(|f| wrong(f.correct_2d))));
        rows.push(row("Fixed 2D rms (m)", fixes(|f| meters(Some(f.err2d.rms)))));
        rows.push(row("Fixed 2D 95 % (m)", fixes(|f| meters(Some(f.err2d.p95)))));
        rows.push(row("Time to first fix (s)", fixes(|f| plain(Some(f.ttff_s), 1))));
    }
    rows
}

fn wrong(correct: f64) -> String {
    format!("{:.2} %", 100.0 * (1.0 - correct))
}

fn reason_rows(comparison: &Comparison) -> Vec<Row> {
    let counts: Vec<_> = comparison.methods.iter().map(Method::reasons).collect();
    let mut codes: Vec<_> = counts.iter().flat_map(|of_method| of_method.keys()).collect();
    codes.sort_unstable();
    codes.dedup();
    let cell = |code: &str, of_method: &std::collections::BTreeMap<&str, usize>| {
        of_method.get(code).map_or_else(|| "–".to_owned(), usize::to_string)
    };
    codes.iter().map(|code| row(code, counts.iter().map(|c| cell(code, c)))).collect()
}

fn table(title: &str, rows: &[Row], comparison: &Comparison) -> String {
    let mut text = format!("<h2>{title}</h2>\n{}<table><thead><tr><th></th>", wide(title));
    for (index, method) in comparison.methods.iter().enumerate() {
        let profile = escape(&method.profile);
        text += &format!(
            "<th>{}{}<br><span class=\"muted\">{profile}</span></th>",
            swatch(&css_color(index)),
            escape(&method.name())
        );
    }
    text += "</tr></thead><tbody>\n";
    for (name, cells) in rows {
        text += &format!("<tr><td>{}</td>", escape(name));
        cells.iter().for_each(|cell| text += &format!("<td>{}</td>", escape(cell)));
        text += "</tr>\n";
    }
    text + "</tbody></table></div>\n"
}

fn agreement(comparison: &Comparison) -> String {
    let agreements = comparison.agreements();
    if agreements.is_empty() {
        return String::new();
    }
    let mut titles = vec!["", "epochs of both", "median (m)", "95 % (m)", "max (m)"];
    if comparison.is_relative() {
        titles.extend(["both fixed", "within 5 cm", "within 10 cm"]);
    }
    let titles: String = titles.iter().map(|title| format!("<th>{title}</th>")).collect();
    let mut text = format!(
        "<h2>Horizontal distance between methods</h2>\n{}<table><thead><tr>\
         {titles}</tr></thead><tbody>\n",
        wide("Distances")
    );
    for agreement in agreements {
        let name = |index: usize| {
            let method = &comparison.methods[index];
            format!("{} ({})", method.name(), method.profile)
        };
        let (all, within) = (&agreement.all, agreement.fixed_within_5_and_10_cm);
        let mut cells = vec![
            format!("{} – {}", name(agreement.pair.0), name(agreement.pair.1)),
            all.n.to_string(),
            meters(Some(all.p50)),
            meters(Some(all.p95)),
            meters(Some(all.max)),
        ];
        if comparison.is_relative() {
            cells.push(agreement.fixed.map_or_else(|| "–".to_owned(), |f| f.n.to_string()));
            cells.push(percent(within.map(|(near, _)| near)));
            cells.push(percent(within.map(|(_, far)| far)));
        }
        text += "<tr>";
        cells.iter().for_each(|cell| text += &format!("<td>{}</td>", escape(cell)));
        text += "</tr>\n";
    }
    text + "</tbody></table></div>\n"
}

fn legend(comparison: &Comparison) -> String {
    let entry = |(index, method): (usize, &Method)| {
        let name = escape(&format!("{} ({})", method.name(), method.profile));
        format!("<span>{}{name}</span>", swatch(&css_color(index)))
    };
    comparison.methods.iter().enumerate().map(entry).collect()
}

fn status_legend() -> String {
    let entry = |quality| {
        let (color, name) = css_quality(quality);
        format!("<span>{}{name}</span>", swatch(&color))
    };
    [1, 2, 5].map(entry).concat()
}

fn configuration(comparison: &Comparison) -> String {
    let mut text = String::from("<h2>How it was made</h2>\n");
    let version = env!("CARGO_PKG_VERSION");
    let _ =
        writeln!(text, "<p>Graphfix {version}: <code>{}</code></p>", escape(&comparison.command));
    text += "<ul>\n";
    for method in &comparison.methods {
        let overrides = match method.overrides.is_empty() {
            true => "no option changed".to_owned(),
            false => {
                let list = method.overrides.iter().map(|(name, value)| format!("{name}={value}"));
                list.collect::<Vec<_>>().join(", ")
            }
        };
        let line = format!(
            "{}, profile {}: {overrides}; configuration {}",
            method.name(),
            method.profile,
            method.configuration_hash
        );
        let _ = writeln!(text, "<li>{}</li>", escape(&line));
    }
    text + "</ul>\n"
}

fn speed(method: &Method) -> String {
    plain(Some(method.solutions.len() as f64 / method.elapsed_s.max(1e-9)), 0)
}

fn meters(value: Option<f64>) -> String {
    let decimals = if value.is_some_and(|value| value.abs() < 0.1) { 4 } else { 2 };
    plain(value, decimals)
}

fn plain(value: Option<f64>, decimals: usize) -> String {
    value.map_or_else(|| "–".to_owned(), |value| format!("{value:.decimals$}"))
}

fn percent(share: Option<f64>) -> String {
    share.map_or_else(|| "–".to_owned(), |share| format!("{:.1} %", 100.0 * share))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluation::Truth;
    use crate::evaluation::sample::{PLACE, solution};
    fn method(mode: &str, errors_m: &[f64], status: Status) -> Method {
        let solve = |(second, east_m): (usize, &f64)| solution(second, *east_m, status);
        Method {
            mode: mode.to_owned(),
            answer: "causal".to_owned(),
            profile: "general".to_owned(),
            configuration_hash: "abc".to_owned(),
            overrides: vec![("elevation_mask_deg".to_owned(), "<10>".to_owned())],
            solutions: errors_m.iter().enumerate().map(solve).collect(),
            elapsed_s: 1.0,
        }
    }

    fn comparison(methods: Vec<Method>, truth: Option<&Truth>) -> Comparison {
        Comparison::new("a<b.obs".to_owned(), "graphfix compare".to_owned(), methods, truth, 0.1)
    }

    #[test]
    fn the_first_table_is_the_papers() {
        let methods = vec![method("spp", &[3.0, 5.0, 10.0], Status::Single)];
        let comparison = comparison(methods, Some(&Truth::Static(PLACE)));
        let page = comparison.html().unwrap();
        // Mean 6; squares 9 + 1 + 16 over 2, so √13.
        for row in
            ["MEAN 2D (m)</td><td>6.00", "STD 2D (m)</td><td>3.61", "MAX 2D (m)</td><td>10.00"]
        {
            assert!(page.contains(row), "{row}");
        }
        assert!(page.contains("Availability</td><td>100.0 %"));
        assert!(
            page.contains("a&lt;b.obs") && page.contains("&lt;10&gt;") && !page.contains("a<b")
        );
        assert!(!page.contains("Fixed rate"), "nothing was relative to a base");
        assert_eq!(page.matches("<svg").count(), page.matches("</svg>").count());
        assert!(!page.contains("http://") || page.contains("http://www.w3.org"), "self-contained");
    }

    #[test]
    fn without_truth_methods_are_held_against_one_another() {
        let fixed = method("rtk-fgo", &[0.0, 0.0, 0.0, 0.0], Status::Fixed);
        let other = method("rtk-ekf", &[0.01, 0.04, 0.07, 0.2], Status::Fixed);
        let page = comparison(vec![fixed, other], None).html().unwrap();
        assert!(page.contains("No truth was given"));
        assert!(page.contains("<td>50.0 %</td><td>75.0 %</td>"), "within 5 and 10 cm");
        assert!(page.contains("Fixed rate</td><td>100.0 %"));
    }

    #[test]
    fn a_wrong_fix_is_told() {
        let methods = vec![method("rtk-fgo", &[0.0, 0.0, 0.0, 0.3], Status::Fixed)];
        let page = comparison(methods, Some(&Truth::Static(PLACE))).html().unwrap();
        assert!(page.contains("Wrong fixes (2D beyond the limit)</td><td>25.00 %"));
    }
}
