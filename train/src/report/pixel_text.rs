//! Numbers with a unit, written into pictures in letters of a few dots.

use super::picture::Picture;

/// Rows of a letter.
pub(super) const HEIGHT: usize = 7;

/// Letters, rows from the top, `#` for a dot.
const LETTERS: [(char, [&str; HEIGHT]); 14] = [
    ('0', [" ### ", "#   #", "#  ##", "# # #", "##  #", "#   #", " ### "]),
    ('1', ["  #  ", " ##  ", "  #  ", "  #  ", "  #  ", "  #  ", " ### "]),
    ('2', [" ### ", "#   #", "    #", "   # ", "  #  ", " #   ", "#####"]),
    ('3', ["#####", "   # ", "  #  ", "   # ", "    #", "#   #", " ### "]),
    ('4', ["   # ", "  ## ", " # # ", "#  # ", "#####", "   # ", "   # "]),
    ('5', ["#####", "#    ", "#### ", "    #", "    #", "#   #", " ### "]),
    ('6', ["  ## ", " #   ", "#    ", "#### ", "#   #", "#   #", " ### "]),
    ('7', ["#####", "    #", "   # ", "  #  ", "  #  ", "  #  ", "  #  "]),
    ('8', [" ### ", "#   #", "#   #", " ### ", "#   #", "#   #", " ### "]),
    ('9', [" ### ", "#   #", "#   #", " ####", "    #", "   # ", " ##  "]),
    ('.', ["  ", "  ", "  ", "  ", "  ", "##", "##"]),
    (' ', ["   ", "   ", "   ", "   ", "   ", "   ", "   "]),
    ('p', ["     ", "     ", "#### ", "#   #", "#### ", "#    ", "#    "]),
    ('x', ["     ", "     ", "#   #", " # # ", "  #  ", " # # ", "#   #"]),
];

/// The dots of a letter; others than [`LETTERS`] are left blank.
fn letter(of: char) -> &'static [&'static str; HEIGHT] {
    let (_, dots) = LETTERS.iter().find(|(known, _)| *known == of).unwrap_or(&LETTERS[11]);
    dots
}

/// Dots from the left end of a text to its right end.
pub(super) fn width_of(text: &str) -> usize {
    text.chars().map(|of| letter(of)[0].len() + 1).sum::<usize>().saturating_sub(1)
}

/// Writes digits, points, spaces and `px` in dark dots of `dot` x `dot` pixels, from the column and row of the text's upper left
/// corner; what would lie outside is left out.
pub(super) fn draw(picture: &mut Picture, text: &str, (left, top): (usize, usize), dot: usize) {
    let mut begin = 0;
    for of in text.chars() {
        let dots = letter(of);
        for (row, line) in dots.iter().enumerate() {
            for (column, _) in line.bytes().enumerate().filter(|(_, byte)| *byte == b'#') {
                fill(picture, (left + dot * (begin + column), top + dot * row), dot);
            }
        }
        begin += dots[0].len() + 1;
    }
}

fn fill(picture: &mut Picture, (left, top): (usize, usize), side: usize) {
    let (right, bottom) = ((left + side).min(picture.width), (top + side).min(picture.height));
    for row in top..bottom {
        for column in left..right {
            picture.pixels[row * picture.width + column] = [17, 23, 34, 255];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn letters_have_equal_rows_and_differ() {
        for (i, (_, dots)) in LETTERS.iter().enumerate() {
            assert!(dots.iter().all(|row| row.len() == dots[0].len()));
            assert!(LETTERS[i + 1..].iter().all(|(_, other)| other != dots));
        }
    }

    #[test]
    fn text_is_drawn_where_it_should_be_and_cut_at_the_edge() {
        let blank = Picture { width: 20, height: 9, pixels: vec![[255; 4]; 180] };
        let mut picture = blank.clone();
        draw(&mut picture, "1", (2, 1), 1);
        let dark: Vec<usize> = (0..180).filter(|i| picture.pixels[*i][0] < 255).collect();
        assert_eq!((dark.first(), dark.last(), dark.len()), (Some(&(20 + 4)), Some(&(7 * 20 + 5)), 10));
        assert_eq!(width_of("10 px"), 5 + 1 + 5 + 1 + 3 + 1 + 5 + 1 + 5);
        let mut picture = blank;
        draw(&mut picture, "8.5 px", (15, 5), 3);
        assert!(picture.pixels[8 * 20 + 19][0] < 255 || picture.pixels[5 * 20 + 18][0] < 255);
    }
}
