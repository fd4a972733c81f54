//! Tables as programs write them.

use super::*;

const COLUMNS: [HeaderColumn; 4] = [
    HeaderColumn::needed("trial", Quantity::Text),
    HeaderColumn::needed("t", Quantity::Time),
    HeaderColumn::needed("Fz", Quantity::Force),
    HeaderColumn { name: "Ty", quantity: Quantity::Torque, required: false },
];

/// The numbers of a table, row by row, and its notes; or the error.
fn read_text(text: impl AsRef<[u8]>) -> std::result::Result<(Vec<[f64; 2]>, Vec<String>), String> {
    let mut rows = Vec::new();
    let summary = parse(Path::new("log.csv"), text.as_ref(), &ReadOptions::new(&COLUMNS), |row| {
        row.needed_text(0)?;
        rows.push([row.needed_time(1)?, row.needed(2)?]);
        row.number(3)?;
        Ok(())
    });
    summary.map(|s| (rows, s.notes)).map_err(|e| e.to_string())
}

#[test]
fn dialects_give_the_same_numbers() {
    let usual = "trial,t,Fz,Ty\na,0.5,-1.25,\nb,1.5,2.5,\n";
    let same = [
        usual.to_owned(),
        usual.replace('\n', "\r\n"),
        format!("\u{feff}{usual}"),
        format!("\u{feff}{}", usual.replace("trial,", "\"trial\",")),
        usual.replace(',', "\t"),
        usual.replace(',', ";"),
        usual.replace(',', "|"),
        usual.replace(',', ";").replace('.', ","),
        format!("sep=;\r\n{}", usual.replace(',', ";").replace('.', ",")),
        "trial,t,Fz\na,\"0,5\",\"-1,25\"\nb,\"1,5\",\"2,5\"\n".into(),
        "# made by a program; with, other; signs\n\ntrial;t;Fz;\na;0,5;-1,25;;;\nb;1,5;2,5;\n;;;\n\n".into(),
        "trial,t,Fz,Ty\n,s,N,\na,0.5,-1.25,\nb,1.5,2.5,\n".into(),
        "trial;t;Fz;Ty\n-;[ms];(mN);N·m\na;500;-1250;\nb;1500;2500;\n".into(),
        usual.replace('-', "\u{2212}"),
        "Trial;t_ms;FZ (mN)\na;500;-1250\nb;1500;2500\n".into(),
        "Trial,t / ms,FZ/(mN),Ty / (N·m)\na,500,-1250,\nb,1500,2500,\n".into(),
        "TRIAL,t,fz_mN,Ty\na,0.5,-1250,\nb,1.5,2500,\n".into(),
        "trial,t [ms],Fz\n,ms,mN\na,500,-1250\nb,1500,2500\n".into(),
    ];
    for text in same {
        let read = read_text(&text).unwrap_or_else(|e| panic!("{text:?}: {e}"));
        assert_eq!(read.0, [[0.5, -1.25], [1.5, 2.5]], "{text:?}");
    }
    assert_eq!(read_text(usual).unwrap().1, Vec::<String>::new());
    let notes = read_text("trial;t;Fz\n;s;N\na;0,5;1\n").unwrap().1;
    assert_eq!(notes, ["columns are separated by ';'", "row 2 has the units", "numbers have a decimal comma"]);
}

#[test]
fn errors_name_the_cause() {
    let told = |text: &str, words: &str| {
        let error = read_text(text).expect_err(text);
        assert!(error.contains(words) && !error.contains('\n'), "{text:?}: {error:?} lacks {words:?}");
    };
    told(
        "trial,t,Fz\na,1.5,\"2,5\"\n",
        "row 2, column Fz: 2,5 has a decimal comma, and a number in row 2 has a decimal point",
    );
    told("trial;t;Fz\na;1,5;2\nb;2,5;2.25\n", "row 3, column Fz: 2.25 has a decimal point");
    told("trial;t;Fz\na;1.234,5;2\n", "separator of thousands");
    told("trial,t,Fz\na,1,\"1,234,567\"\n", "separator of thousands");
    told("trial,t,Fz\na,1,\"1,234\"\nb,2,\"2,500\"\n", "row 2: are its commas decimal, or between thousands?");
    told(
        "trial,t,Fz\n,s,pound\na,1,2\n",
        "row 2, column Fz: \"pound\" is no number, and no unit of this column; known: N,",
    );
    told("trial,t,Fz [N]\n,s,mN\na,1,2\n", "row 2, column Fz: \"mN\" is another unit");
    told("trial,t,Fz\na,0,5,1,25\n", "5 cells where the header has 3 columns; if it has decimal commas");
    told("trial,t,Fz\na,1\n", "row 2: 2 cells where the header has 3 columns");
    told("sep=;\ntrial;t;Fz\na;1;x\nb;2;y\n", "row 3, column Fz: \"x\" is no number");
    told("trial,t,Fz\na,1764000000000,1\n", "counts ms from 1970: write t [ms] in the header");
    told("trial,t,Fz\na,1764000000000000000,1\n", "counts ns from 1970");
    told("PK\u{3}\u{4}rest", "save the sheet as CSV");
    let wide: Vec<u8> = "trial,t,Fz\n".encode_utf16().flat_map(u16::to_le_bytes).collect();
    assert!(read_text([&[0xff, 0xfe], &wide[..]].concat()).unwrap_err().contains("UTF-16"));
    assert_eq!(read_text("trial,t,Fz\na,1764000000.25,1\n").unwrap().0, [[1764000000.25, 1.0]]);
}
