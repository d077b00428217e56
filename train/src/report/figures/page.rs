//! All figures on one page.

use minijinja::{Environment, Value, context};

use super::Figure;
use crate::report::ReportError;

const TEMPLATE: &str = include_str!("page.html");

/// The page, with the pictures inside.
///
/// **Errors** when the template fails, which no input can cause.
pub fn page(figures: &[Figure]) -> Result<String, ReportError> {
    let mut environment = Environment::new();
    environment.add_template("page.html", TEMPLATE)?;
    let figure = |f: &Figure| {
        context! {
            name => f.name,
            title => f.title,
            caption => f.caption,
            svg => Value::from_safe_string(f.svg.trim_end().to_owned()),
        }
    };
    let figures: Vec<Value> = figures.iter().map(figure).collect();
    Ok(environment.get_template("page.html")?.render(context! { figures => figures })?)
}
